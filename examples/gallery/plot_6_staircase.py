"""
A staircase for the threshold of friction
=========================================

How much must the friction differ from 0.35 so that a person notices? A weighted up-down staircase
asks for the difference that is noticed in 75 % of the trials. The staircase is that of `SweetSpot
<https://pypi.org/project/SweetSpot>`_ (CC0). Each trial strokes the plate; the observer is
simulated, compares the friction that there really was, and guesses when in doubt.
"""

import matplotlib.pyplot as plt
import numpy as np
from SweetSpot import WUD, Logistic, PsychometricFunction

from smarttac_can.bench import Stimulator

noise = np.random.default_rng(1)
noticed = PsychometricFunction(  # as likely as this, in a choice of two
    alpha=0.04, beta=np.log(40), gamma=0.5, lambda_=0.01, shape=Logistic
)
staircase = WUD(start=0.12, hitEffect=-0.01, target=0.75, reversals=16, reversalsToUse=12)
with Stimulator.simulate("local", subject=2) as bench:
    bench.finger.stroke(2, force=0.5, speed=60)
    bench.start_run()
    bench.tare()
    bench.amplitude = 1.0
    bench.mode = "friction"
    bench.run(0.3)
    while not staircase.Finished():
        felt = []
        for cof in (0.35, 0.35 + max(staircase.PendingValue(), 0.0)):
            bench.cof = cof
            felt.append(np.nanmedian(bench.run(0.15).cof))
        chance = noticed.Forward(abs(felt[1] - felt[0])).item()
        staircase.Observe(int(noise.random() < chance))
threshold = staircase.Estimate()
print(f"threshold {threshold:.3f} after {staircase.NumberOfPoints()} trials")

figure, axes = plt.subplots(figsize=(7, 4))
staircase.PlotStaircase(axes=axes, hold=True, markersize=5)
axes.set(xlabel="trial", ylabel="difference of the COF")
axes.set_title("filled: noticed; large: reversal; dashed: threshold")
plt.show()
