"""
Friction against amplitude
==========================

The more the plate vibrates, the less it rubs. Three simulated subjects stroke it while the
amplitude is held at six levels.
"""

import matplotlib.pyplot as plt
import numpy as np

from smarttac_can.bench import Stimulator

levels = np.linspace(0.0, 2.0, 6)  # um peak-to-peak
figure, axes = plt.subplots(figsize=(6, 4))
for subject in (1, 2, 5):
    cof = []
    with Stimulator.simulate("local", subject=subject) as bench:
        bench.finger.stroke(subject, force=0.5, speed=60)
        bench.start_run()
        bench.tare()
        bench.run(0.3)
        for level in levels:
            bench.amplitude = level
            bench.mode = "amplitude_resonance" if level else "off"
            bench.run(0.1)
            cof.append(np.nanmedian(bench.run(0.6).cof))
    ratio = 100 * np.array(cof) / cof[0]
    axes.plot(levels, ratio, "o-", label=f"subject {subject}")
    print(f"subject {subject}: {ratio[-1]:.0f} % of the friction is left at {levels[-1]:g} um")

axes.set(xlabel="amplitude (um)", ylabel="friction (% of that without vibration)", ylim=(0, None))
axes.legend()
plt.show()
