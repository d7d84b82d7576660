"""
A fault in a test
=================

What does your software do when a sensor breaks? Let one break, and look. A gauge sticks here
while the amplitude is regulated. The events say what happens, and the plate is at 0 V within 24
ms.
"""

import matplotlib.pyplot as plt

from smarttac_can.bench import FaultError, Stimulator

with Stimulator.simulate("local") as bench, bench.events() as events:
    bench.amplitude = 1.0
    bench.mode = "amplitude_resonance"
    before = bench.run(0.05)
    bench.set("Fault.Sensor", 3)
    bench.set("Fault.Kind", 1)  # stuck
    try:
        bench.run(0.05)
    except FaultError as error:
        print(error)
        after = error.trace
    bench.set("Fault.Kind", 0)
    bench.run(0.1)  # with the fault known, it just records
    bench.reset_fault()
    for event in events.within(0):
        print(f"node {event.node_id}: {event.kind}: {event.text}")

broken = after.tick[0]
assert after.voltage_v[-1] == 0, "the plate has to be at 0 V"
figure, axes = plt.subplots(figsize=(7, 4))
for trace in (before, after):
    axes.plot(trace.tick - broken, trace.voltage_v, "o-", markersize=3, color="C0")
axes.axvline(0, color="C3", label="the gauge sticks")
axes.set(xlabel="time (ms)", ylabel="voltage (V)", xlim=(-50, 50))
axes.legend()
plt.show()
