"""Measurement of how punctual the loop is on the wall clock, at the bus and at the stage."""

from smarttac_can.assurance.timing.loop_run import measure_loop

__all__ = ["measure_loop"]
