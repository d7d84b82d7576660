"""
A plate that gets warm
======================

A warmer plate has a lower resonance. Mode ``amplitude`` stays at one frequency and pays with
voltage. Mode ``amplitude_resonance`` follows the resonance.
"""

import matplotlib.pyplot as plt

from smarttac_can.bench import Stimulator

temperatures = range(10, 31, 4)
voltage = {"amplitude": [], "amplitude_resonance": []}
resonance = []
for mode, volts in voltage.items():
    for temperature in temperatures:
        with Stimulator.simulate("local") as bench:
            bench.finger.lift()
            bench.finger.surroundings(temperature=temperature)
            bench.start_run()
            bench.amplitude = 1.0
            bench.mode = mode
            trace = bench.run(0.3)
        volts.append(trace.voltage_v[-50:].mean())
        if mode == "amplitude_resonance":
            resonance.append(trace.frequency_hz[-50:].mean())
print(f"resonance {resonance[0]:.0f} Hz at 10 degC, {resonance[-1]:.0f} Hz at 30 degC")

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
left.plot(temperatures, resonance, "o-")
left.set(xlabel="temperature (degC)", ylabel="resonance (Hz)")
for mode, volts in voltage.items():
    right.plot(temperatures, volts, "o-", label=mode)
right.set(xlabel="temperature (degC)", ylabel="voltage for 1 um (V)", ylim=(0, None))
right.legend()
plt.show()
