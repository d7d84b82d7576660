"""Evidence: the trials of faults, sensors, hours and attacks, and the timing of the loop."""
