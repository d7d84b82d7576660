"""How punctual the loop is on the wall clock, measured from the bus and at the stage."""
