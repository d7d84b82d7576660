"""
A finger of your own
====================

The finger need not stroke to and fro. Here it lands, presses harder and harder while it slides,
and leaves. The friction is regulated to 0.35 meanwhile.
"""

import matplotlib.pyplot as plt
import numpy as np

from smarttac_can.bench import Stimulator

finger = [  # time in s, position in mm, normal force in N
    (0.30, -15, 0.0),
    (0.35, -15, 0.3),
    (1.00, 15, 1.2),
    (1.05, 15, 0.0),
]
with Stimulator.simulate("local", subject=2, finger=finger) as bench:
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0  # while nobody touches
    bench.cof = 0.35
    bench.mode = "friction"
    trace = bench.run(1.2)
sliding = (trace.position_mm > -10) & (trace.position_mm < 14)
print(f"median COF {np.median(trace.cof[sliding]):.3f}")

figure, (force, cof, amplitude) = plt.subplots(3, sharex=True, figsize=(7, 6))
force.plot(trace.time_s, trace.normal_force_n, label="normal")
force.plot(trace.time_s, trace.tangential_force_n, label="tangential")
force.set(ylabel="force (N)")
force.legend()
cof.plot(trace.time_s, trace.cof)
cof.axhline(0.35, color="black", linewidth=0.8)
cof.set(ylabel="COF", ylim=(0, 0.6))
amplitude.plot(trace.time_s, trace.amplitude_um)
amplitude.set(ylabel="amplitude (um)", xlabel="time (s)")
plt.show()
