"""Fault matrix and soak: every fault in every mode, and hours with faults at random."""
