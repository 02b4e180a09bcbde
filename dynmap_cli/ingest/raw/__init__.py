"""What a recording holds before anything is decided."""
