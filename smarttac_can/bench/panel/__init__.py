"""Panel in a browser for a simulated bench, or for a stimulator on a bus. Needs aiohttp."""

from smarttac_can.bench.panel.instrument import BusInstrument, Instrument, SimulatedBench

__all__ = ["BusInstrument", "Instrument", "SimulatedBench"]
