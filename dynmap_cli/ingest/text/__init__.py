"""Text logs of CARMEN and Wean Hall -> raw recording."""
