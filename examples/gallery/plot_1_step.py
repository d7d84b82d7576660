"""
Step response of the amplitude
==============================

The vibration steps from 0.5 to 1.0 um under a finger, by each of the three laws. The two PIs of
the paper were designed for the bare plate. The other laws expect a finger.
"""

import matplotlib.pyplot as plt

from smarttac_can.bench import Stimulator

figure, axes = plt.subplots(figsize=(7, 4))
for law in ("pi", "scheduled", "predictive"):
    with Stimulator.simulate("local", subject=2) as bench:
        bench.finger.stroke(2, force=0.5, speed=40)
        bench.start_run()
        bench.tare()
        bench.vibration_law = law
        bench.amplitude = 0.5  # um peak-to-peak
        bench.mode = "amplitude_resonance"
        bench.run(0.4)  # the finger is down, and the loop has settled
        bench.amplitude = 1.0
        trace = bench.run(0.03)
    time_ms = 1e3 * (trace.time_s - trace.time_s[0])
    axes.plot(time_ms, trace.amplitude_um, "o-", markersize=3, label=law)
    print(f"{law}: 0.95 um after {time_ms[trace.amplitude_um > 0.95][0]:.0f} ms")

axes.axhline(1.0, color="black", linewidth=0.8)
axes.set(xlabel="time after the step (ms)", ylabel="amplitude (um)")
axes.legend()
plt.show()
