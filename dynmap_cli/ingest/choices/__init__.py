"""What is decided about a recording: lasers, odometry, frames, times, ranges; and what is doubtful in it."""
