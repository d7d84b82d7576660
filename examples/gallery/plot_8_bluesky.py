"""
A device in a bluesky RunEngine
===============================

The stimulator as an `ophyd-async <https://blueskyproject.io/ophyd-async>`_ device: a bluesky plan
sets its amplitude, and reads the friction that is left. What a plan emits can go to any of
bluesky's databases; here it goes to a list.
"""

import asyncio

import matplotlib.pyplot as plt
import numpy as np
from bluesky import RunEngine
from bluesky import plans as bp
from bluesky.protocols import Movable
from ophyd_async.core import AsyncStatus, StandardReadable, init_devices, soft_signal_r_and_setter

from smarttac_can.bench import Stimulator


class Plate(StandardReadable, Movable):
    """A plate under a finger: set to an amplitude in um, it reads voltage and friction."""

    def __init__(self, bench: Stimulator, name: str = "") -> None:
        self._bench = bench
        with self.add_children_as_readables():
            self.amplitude, self._set_amplitude = soft_signal_r_and_setter(float, units="um")
            self.voltage, self._set_voltage = soft_signal_r_and_setter(float, units="V")
            self.cof, self._set_cof = soft_signal_r_and_setter(float)
        super().__init__(name)

    @AsyncStatus.wrap
    async def set(self, value: float) -> None:
        """Regulate an amplitude, and take the means over one stroke."""
        self._bench.amplitude = value
        trace = await asyncio.to_thread(self._bench.run, 0.8)
        self._set_amplitude(trace.amplitude_um[200:].mean())
        self._set_voltage(trace.voltage_v[200:].mean())
        self._set_cof(np.nanmedian(trace.cof[200:]))


rows = []
with Stimulator.simulate("local") as bench:
    bench.finger.stroke(2, force=0.5, speed=60)
    bench.start_run()
    bench.tare()
    bench.mode = "amplitude_resonance"
    RE = RunEngine()
    with init_devices():
        plate = Plate(bench)
    RE(bp.scan([plate], plate, 0.4, 2.0, 5), {"event": lambda _, doc: rows.append(doc["data"])})
for row in rows:
    print({name: round(value, 3) for name, value in sorted(row.items())})

figure, axes = plt.subplots(figsize=(6, 4))
axes.plot([row["plate-amplitude"] for row in rows], [row["plate-cof"] for row in rows], "o-")
axes.set(xlabel="amplitude (um)", ylabel="COF")
plt.show()
