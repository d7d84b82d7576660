"""Buses, clock, log files, process signals and the loop that runs a node on them."""
