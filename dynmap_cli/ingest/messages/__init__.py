"""Messages of ROS and Foxglove, one by one or many at a time -> raw recording."""
