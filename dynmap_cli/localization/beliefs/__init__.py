"""What is believed of the states of sub-maps and objects, and how long they last."""
