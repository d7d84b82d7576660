"""Measurement of how punctual the loop is on the wall clock, at the bus and at the stage."""

from smarttac_can.timing.loop_run import measure_loop

__all__ = ["measure_loop"]
