"""The plate and the finger of the control tests: eq. (6) and (7) exactly, and a friction curve."""

import cmath
import math
import random
from dataclasses import replace

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TICK, Drive, Measurement, Setpoint
from smarttac_can.vocabulary.textures import Axis, TextureTable

GRATING = TextureTable(Axis.POSITION, True, 0, 1_000_000, (3000, 4000))
GAUGE_X = (-28e-3, 28e-3, -28e-3, 28e-3)


def setpoint(
    voltage=0.0, frequency=43390.0, amplitude=1e-6, mu_left=0.3, mu_right=0.4, boundary=0.0
):
    return Setpoint(voltage, frequency, amplitude, mu_left, mu_right, boundary)


def gauges(Fx=0.0, Fy=0.0, Fn=0.0, x=0.0):
    lean = Fn * x / GAUGE_X[1]
    left, right = 0.25 * (Fn - lean), 0.25 * (Fn + lean)
    return (Fx, Fy, left, right, left, right)


class FirstOrderPlate:
    """tau W' = -(1 + j tau dw) W + gain V."""

    def __init__(self, model=None, dead_time=0.0, noise=0.0, offset=0j, seed=1):
        self.model = PlateModel() if model is None else model
        self.W = 0j
        self.dead_time = dead_time
        self._old = Drive(0.0, self.model.f0)
        self._noise = noise
        self._offset = offset
        self._random = random.Random(seed)

    def step(self, drive):
        self._advance(self._old, self.dead_time)
        self._advance(drive, TICK - self.dead_time)
        self._old = drive

    def _advance(self, drive, duration):
        m = self.model
        rate = -complex(1.0 / m.tau, 2.0 * math.pi * (drive.frequency - m.f0))
        steady = -m.gain * drive.voltage / m.tau / rate
        self.W = steady + (self.W - steady) * cmath.exp(rate * duration)

    def measure(self, forces=(0.0,) * 6):
        W = self.W + self._offset
        if self._noise:
            W += complex(self._random.gauss(0.0, self._noise), self._random.gauss(0.0, self._noise))
            W = complex(round(W.real * 1e10) / 1e10, round(W.imag * 1e10) / 1e10)
        return Measurement(W, forces, 20.0, 0)


class UnlikeTheModel(FirstOrderPlate):
    """A plate that softens, or whose losses grow, with a second mode that the pick-up sees.

    Softening in Hz/m and losses in 1/m are for an amplitude to the given powers. The second mode
    has a share of the gain, and its resonance is off by an offset in Hz.
    """

    def __init__(self, softening=0.0, losses=0.0, power=1, share=0.0, offset=0.0, **options):
        super().__init__(**{"noise": 1e-9, **options})
        self.softening, self.losses, self.power = softening, losses, power
        bare = self.model
        self.second = FirstOrderPlate(replace(bare, f0=bare.f0 + offset))
        self.share, self.bare = share, bare

    def step(self, drive):
        # A steady state is exact, whatever the number of steps.
        for _ in range(4):
            size = abs(self.W) ** self.power
            less = 1.0 / (1.0 + self.losses * size)
            self.model = replace(
                self.bare,
                gain=less * self.bare.gain,
                tau=less * self.bare.tau,
                f0=self.bare.f0 - self.softening * size,
            )
            self._advance(drive, TICK / 4)
        self.second.step(drive)

    def measure(self, forces=(0.0,) * 6):
        read = super().measure(forces)
        return read._replace(W=read.W + self.share * self.second.W)


class Finger:
    """mu = mu0 (rho + (1 - rho) exp(-W/W0)), felt through a flexure of 100 Hz and damping 0.7."""

    RHO = 0.4
    W0 = 2.5e-6

    def __init__(self, mu0=0.6, Fn=0.5):
        self.mu0, self.Fn = mu0, Fn
        self._mu, self._felt, self._rate = mu0, mu0, 0.0

    def friction(self, W):
        return self.mu0 * (self.RHO + (1.0 - self.RHO) * math.exp(-abs(W) / self.W0))

    def touch(self, W, x=0.0):
        """Gauge forces of this tick, after one with the mean of this and the last friction."""
        mu = self.friction(W)
        held, self._mu = 0.5 * (mu + self._mu), mu
        natural = 2.0 * math.pi * 100.0
        decay = 0.7 * natural
        beat = natural * math.sqrt(1.0 - 0.7**2)
        shrink = math.exp(-decay * TICK)
        cos, sin = math.cos(beat * TICK), math.sin(beat * TICK) / beat
        away, rate = self._felt - held, self._rate
        self._felt = held + shrink * (away * cos + (rate + decay * away) * sin)
        self._rate = shrink * (rate * cos - (decay * rate + natural**2 * away) * sin)
        return gauges(Fx=self._felt * self.Fn, Fn=self.Fn, x=x)


def run(cascade, plate, target, ticks, forces=None):
    """Step the closed loop, with gauge forces that may follow from W; return the drives."""
    drives = []
    for _ in range(ticks):
        measurement = plate.measure(forces(plate.W) if forces else (0.0,) * 6)
        drives.append(cascade.update(measurement, target))
        plate.step(drives[-1])
    return drives


def begun(mode, ticks=0, target=None, forces=None, **parameters):
    """Return a cascade after some ticks in a mode, and its plate."""
    cascade, plate = Cascade(CascadeParameters(**parameters)), FirstOrderPlate()
    cascade.set_mode(mode)
    run(cascade, plate, target or setpoint(), ticks, forces)
    return cascade, plate
