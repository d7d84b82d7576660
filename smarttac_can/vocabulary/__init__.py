"""What both ends of the bus agree on: modes, states, words, watchdogs, faults, and signals."""
