"""The fits of the identification, each on its own: exact on a plate, and refused where none is."""

import math
import random
import re
from itertools import pairwise

import numpy as np
import pytest
from first_order_plate import FirstOrderPlate
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.control.identification import (
    W_PROBE,
    Identification,
    IdentificationError,
    _deviation,
    _fit_sweep,
    _probe,
    _require_data_sheet,
    _require_linear,
    _require_unloaded,
    _steps,
    _Sweep,
)
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.step_response import _unbiased

models = st.builds(
    PlateModel, st.floats(10e-9, 200e-9), st.floats(0.5e-3, 2e-3), st.floats(43_300.0, 43_500.0)
)


def carried_out(procedure, plate):
    """Run a part of the procedure on a plate; return what it comes to, and its drives."""
    drives = [next(procedure)]
    while True:
        plate.step(drives[-1])
        try:
            drives.append(procedure.send(plate.measure().W))
        except StopIteration as end:
            return end.value, drives


def swept(model, V=10.0, count=9, width=150.0):
    frequencies = np.linspace(model.f0 - width, model.f0 + width, count).tolist()
    return [
        (f, model.gain * V / complex(1.0, 2.0 * math.pi * model.tau * (f - model.f0)))
        for f in frequencies
    ]


@given(model=models, off=st.floats(-2500.0, 2500.0))
@settings(max_examples=25, deadline=None)
def test_steps_tell_any_plate_however_far_off_they_are_made(model, off):
    plate = FirstOrderPlate(model, dead_time=300e-6)
    V = 1e-6 / model.gain
    steps = _steps(V, model.f0 + off, 0j, 0.0, 4)
    (tau, f0, gain, response), drives = carried_out(steps, plate)
    assert response.delay == pytest.approx(300e-6, abs=1e-6)
    assert response.tolerance == 100e-6
    assert tau == pytest.approx(model.tau, rel=1e-6)
    assert f0 == pytest.approx(model.f0, abs=1e-3)
    assert gain == pytest.approx(model.gain, rel=1e-6)
    assert {drive.voltage for drive in drives} == {0.0, V}


@given(model=models, V=st.floats(1.0, 40.0))
@settings(max_examples=25)
def test_a_sweep_tells_any_plate(model, V):
    found = _fit_sweep(V, swept(model, V), 1e-12)
    assert found.gain == pytest.approx(model.gain, rel=1e-9)
    assert found.tau == pytest.approx(model.tau, rel=1e-9)
    assert found.f0 == pytest.approx(model.f0, abs=1e-6)


def test_a_sweep_of_no_resonance_is_refused():
    points = swept(PlateModel())
    for wrong, message in (
        ([(f, 0j) for f, _ in points], "no vibration in the sweep"),
        # It would grow, or turn the wrong way.
        ([(f, -W) for f, W in points], "the sweep shows no resonance"),
        ([(f, -W.conjugate()) for f, W in points], "the sweep shows no resonance"),
        ([(f, W.conjugate()) for f, W in points], "the sweep shows no resonance"),
    ):
        with pytest.raises(IdentificationError, match=message):
            _fit_sweep(10.0, wrong, 1e-12)


@pytest.mark.parametrize(("share", "least", "most"), [(1.2, 10, 22), (1.4, 20, 42)])
def test_a_point_off_the_resonance_is_told_by_how_much(share, least, most):
    points = swept(PlateModel(), count=17)
    points[3] = (points[3][0], share * points[3][1])
    with pytest.raises(IdentificationError, match="off a resonance") as refusal:
        _fit_sweep(10.0, points, 1e-12)
    (percent,) = re.findall(r"the sweep is (\d+) %", str(refusal.value))
    assert least <= int(percent) <= most
    # What is noise is no refusal.
    _fit_sweep(10.0, points, 0.1 * share * abs(points[8][1]))


@pytest.mark.parametrize(("gain", "last"), [(50e-9, 20.0), (5e-9, 150.0), (400e-9, 1.0)])
def test_the_voltage_is_doubled_up_to_its_limit_until_the_plate_vibrates(gain, last):
    V, drives = carried_out(_probe(150.0, 43_390.0, 0j, 1e-10), FirstOrderPlate(PlateModel(gain)))
    voltages = sorted({drive.voltage for drive in drives})
    assert voltages == [drive.voltage for drive in drives][:: len(drives) // len(voltages)]
    assert all(b == 2.0 * a for a, b in pairwise(voltages))
    assert V == voltages[-1] <= 150.0
    assert gain * V > W_PROBE or V == 150.0
    assert gain * V / 2.0 <= W_PROBE
    assert last >= V


def test_a_noisy_pickup_asks_for_more_vibration():
    plate = PlateModel()
    quiet, _ = carried_out(_probe(150.0, 43_390.0, 0j, 1e-10), FirstOrderPlate(plate))
    noisy, _ = carried_out(_probe(150.0, 43_390.0, 0j, 30e-9), FirstOrderPlate(plate))
    assert quiet < noisy <= 150.0
    assert plate.gain * noisy == pytest.approx(15.0 * 30e-9, rel=0.01)


def test_a_plate_that_hardly_vibrates_is_refused_at_the_largest_voltage():
    procedure = _probe(150.0, 43_390.0, 0j, 10e-9)
    plate, drive = FirstOrderPlate(PlateModel(gain=1e-9)), next(procedure)
    plate.model = PlateModel(gain=1e-9)
    voltages = []
    with pytest.raises(IdentificationError, match=r"no vibration of 0\.15 um at 20 V"):
        carried_out(_probe(20.0, 43_390.0, 0j, 10e-9), FirstOrderPlate(PlateModel(gain=1e-9)))
    with pytest.raises(IdentificationError):
        while True:
            voltages.append(drive.voltage)
            drive = procedure.send(1e-9 + 0j)
    assert max(voltages) == voltages[-1] == 150.0


@given(a=st.floats(0.05, 0.85), square=st.floats(1e-14, 1e-9), noise=st.floats(0.0, 1.0))
@settings(max_examples=50)
def test_noise_in_both_samples_does_not_shorten_the_decay(a, square, noise):
    both = noise * square
    assert _unbiased(a * square + 0j, square + both, a * a * square + both) == pytest.approx(a)


def test_a_deviation_is_that_of_an_axis():
    draw = random.Random(1)
    values = [complex(draw.gauss(3.0, 1.0), draw.gauss(-1.0, 1.0)) for _ in range(12)]
    axes = [np.var([z.real for z in values], ddof=1), np.var([z.imag for z in values], ddof=1)]
    assert _deviation(values) == pytest.approx(math.sqrt(sum(axes) / 2.0))


@pytest.mark.parametrize("factor", [0.2, 0.6, 0.88])
def test_what_changes_gain_and_tau_alike_is_a_finger_and_nothing_else_is(factor):
    known = PlateModel()
    loaded = PlateModel(factor * known.gain, factor * known.tau)
    percent = f"{100 * (1 - factor):.0f} % below the model"
    with pytest.raises(IdentificationError, match=percent):
        _require_unloaded(loaded, known)
    _require_unloaded(PlateModel(factor * known.gain, known.tau), known)
    _require_unloaded(PlateModel(known.gain, factor * known.tau), known)
    _require_unloaded(known, loaded)
    _require_unloaded(PlateModel(0.92 * known.gain, 0.92 * known.tau), known)


@pytest.mark.parametrize(
    ("gain", "tau", "message"),
    [
        (100e-9, 1e-3, "gain 100 nm/V is +100 % off the data sheet's 50 nm/V, 20 % are believed"),
        (37.5e-9, 1e-3, "gain 37.5 nm/V is -25 % off the data sheet's 50 nm/V, 20 % are believed"),
        (50e-9, 1.5e-3, "tau 1.5 ms is +50 % off the data sheet's 1 ms, 20 % are believed"),
    ],
)
def test_what_is_off_the_data_sheet_is_told_in_its_units(gain, tau, message):
    sheet = CascadeParameters(sheet_gain=50e-9, sheet_tau=1e-3, sheet_tolerance=0.2)
    with pytest.raises(IdentificationError, match=re.escape(message)):
        _require_data_sheet(PlateModel(gain, tau), sheet)
    _require_data_sheet(PlateModel(0.85 * 50e-9, 1.15e-3), sheet)


def test_a_pickup_whose_gain_depends_on_the_amplitude_is_told():
    model = PlateModel()
    other = PlateModel(1.2 * model.gain, model.tau)
    message = "gain changes by +20 % at half the voltage, 5 % are allowed"
    with pytest.raises(IdentificationError, match=re.escape(message)):
        _require_linear(model, other, 0.0)
    with pytest.raises(IdentificationError, match=r"tau changes by -20 %"):
        _require_linear(model, PlateModel(model.gain, 0.8 * model.tau), 0.0)
    _require_linear(model, other, 0.05)


def test_a_sweep_goes_from_end_to_end_and_waits_at_each_frequency():
    sweep = _Sweep(43_300.0, 43_500.0, 7, 12, 0j, 1e-12)
    found = Identification(PlateModel(), 43_390.0, CascadeParameters())
    model, drives = carried_out(found._sweep(10.0, sweep, 5), FirstOrderPlate())
    frequencies = [drive.frequency for drive in drives]
    assert frequencies == [
        f for f in np.linspace(43_300.0, 43_500.0, 5).tolist() for _ in range(19)
    ]
    assert model.f0 == pytest.approx(43_390.0, abs=0.1)


def test_it_rests_first_sweeps_the_width_of_the_resonance_and_again_at_half_the_voltage():
    plate = FirstOrderPlate()
    found = Identification(PlateModel(), 43_390.0, CascadeParameters())
    drives, W = [], 0j
    while (drive := found.update(W)) is not None:
        drives.append(drive)
        plate.step(drive)
        W = plate.measure().W
    assert found.model is not None
    assert found.model.gain == pytest.approx(plate.model.gain, rel=1e-3)
    assert {drive.voltage for drive in drives[:90]} == {0.0}
    check = drives[-1].voltage
    last = max(at for at, drive in enumerate(drives) if drive.voltage != check)
    swept_at = [d.frequency for d in drives if d.voltage == drives[last].voltage]
    assert drives[last].voltage == pytest.approx(2.0 * check)
    # At its ends the plate vibrates by 1/sqrt(2) of what it does in the middle.
    for end in (min(swept_at), max(swept_at)):
        ratio = abs(1.0 / complex(1.0, 2.0 * math.pi * plate.model.tau * (end - plate.model.f0)))
        assert ratio == pytest.approx(math.sqrt(0.5), rel=0.01)


def ended(Ws):
    """Why an identification ends that is shown these."""
    found = Identification(PlateModel(), 43_390.0, CascadeParameters())
    for W in Ws:
        if found.update(W) is None:
            break
    return found.failure


def test_what_is_too_large_or_too_noisy_is_told_in_its_unit():
    assert ended([0j] + [2e-6 + 0j] * 200) == "vibration 2.00 um is above 1.5 um"
    # To and fro by 80 nm on one axis is 59 nm on each.
    noisy = [(-1) ** tick * 80e-9 + 0j for tick in range(200)]
    assert ended(noisy) == "noise of 58 nm at rest is above 50 nm"


def test_a_plate_that_does_nothing_has_no_decay():
    procedure = _steps(20.0, 43_390.0, 0j, 0.0, 2)
    next(procedure)
    with pytest.raises(IdentificationError, match="the response to a step is no decay: 0 is"):
        while True:
            procedure.send(0j)


def test_a_plate_that_is_far_off_rests_before_it_is_looked_for_anew():
    plate, found = FirstOrderPlate(), Identification(PlateModel(), 42_700.0, CascadeParameters())
    drives, W = [], 0j
    while (drive := found.update(W)) is not None:
        drives.append(drive)
        plate.step(drive)
        W = plate.measure().W
    there = [d for d in drives if abs(d.frequency - 43_390.0) < 1.0]
    assert {drive.voltage for drive in there[:80]} == {0.0}
    assert found.model is not None
