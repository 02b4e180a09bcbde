"""What a scan says of a pose: the maps as the filter sees them, and the sensor models."""
