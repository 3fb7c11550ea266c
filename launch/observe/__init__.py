"""Looking on at running sessions from another terminal: which there are, and what they show of themselves."""
