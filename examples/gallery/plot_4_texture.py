"""
A texture
=========

A grating of friction, with ridges every 8 mm. The stimulator plays it by the position of the
finger, and ``track`` says how well it was followed.
"""

import matplotlib.pyplot as plt

from smarttac_can.bench import Stimulator, Texture, track

grating = Texture.grating(period_mm=8, low=0.3, high=0.4)
with Stimulator.simulate("local") as bench:
    bench.finger.stroke(2, force=1.0, speed=60, travel=30)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0  # while nobody touches
    bench.texture = grating
    bench.mode = "texture"
    bench.run(1.0)
    trace = bench.run(2.0)
followed = track(grating, trace.position_mm, trace.cof)
print(f"{followed.passes} passes, rms difference {followed.rms:.3f}")

figure, axes = plt.subplots(figsize=(7, 4))
axes.plot(trace.position_mm, trace.cof, ".", markersize=2, label="measured")
axes.plot(trace.position_mm, grating.cof(trace.position_mm), ".", markersize=2, label="texture")
axes.set(xlabel="position of the finger (mm)", ylabel="COF", xlim=(-13, 13), ylim=(0.2, 0.5))
axes.legend(markerscale=5)
plt.show()
