"""A finger of a campaign by `Plate` and `Cascade`, as a bench would run it."""

import numpy as np

from smarttac_can.science.control import Cascade
from smarttac_can.science.plant import Plate
from smarttac_can.science.plant.finger import FingerState
from smarttac_can.science.population.fingers import CASES, lift, stroke_of
from smarttac_can.science.population.trial import AMPLITUDE, parameters_of, plate_of
from smarttac_can.vocabulary.signals import TARE_SAMPLES, Drive, Setpoint
from smarttac_can.vocabulary.states import Mode


class Lifting:
    """A stroke of a finger that lifts each second."""

    def __init__(self, stroke):
        self._stroke = stroke

    def at(self, time):
        x, Fn = self._stroke.at(time)
        return FingerState(x, Fn * lift(time))


def traces_by_objects(campaign, finger, under, ticks):
    """Return true COF, measured COF and side, a row a tick."""
    case = CASES[campaign.case]
    stroke = stroke_of(finger, case)
    plate = Plate(
        plate_of(case, under),
        finger.subject,
        Lifting(stroke) if case.lifts else stroke,
        seed=finger.noise_seed,
        ambient=under.ambient,
        dead_time=campaign.dead_time,
    )
    cascade = Cascade(parameters_of(campaign, under), under.model)
    off = Drive(0.0, cascade.model.f0)
    setpoint = Setpoint(0.0, off.frequency, AMPLITUDE, finger.mu_left, finger.mu_right, 0.0)
    old = off
    rows = []
    for tick in range(ticks):
        mu_true = plate.mu_true
        new = cascade.update(plate.sample(), setpoint)
        rows.append((mu_true, cascade.contact.mu, float(cascade.mu_ref == finger.mu_right)))
        plate.step(old, new)
        old = new
        if tick == TARE_SAMPLES - 1:
            cascade.zero = cascade.null()
            cascade.set_mode(Mode.FRICTION)
    return np.array(rows)
