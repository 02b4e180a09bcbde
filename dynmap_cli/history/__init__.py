"""Side room: what was seen of each sub-map, and when; why it is one."""
