"""Side room: one plain map for planners, with every area that changes in a chosen state."""
