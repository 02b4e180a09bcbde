"""What lies on disk between rooms."""
