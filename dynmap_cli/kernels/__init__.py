"""The machine room: compiled arithmetic. Arrays and numbers in, numbers out; nothing else."""
