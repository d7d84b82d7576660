"""Object dictionary: EDS loading, data types, units, limits, and the timing of its PDOs."""
