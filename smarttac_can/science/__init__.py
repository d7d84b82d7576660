"""Pure numbers: the plate with its finger, the controllers, and random fingers in the loop."""
