"""Before there is a loop: who is on the bus, node-IDs, DCF, DBC, defaults of an EDS."""
