import math
import random
import statistics
from dataclasses import replace
from itertools import pairwise, product

import pytest
from first_order_plate import (
    GRATING,
    Finger,
    FirstOrderPlate,
    begun,
    gauges,
    run,
    setpoint,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.design import row_of
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import FAULTS, FREQUENCY_STEP, SAVED, control_step
from smarttac_can.science.control.texture import POSITION_LAG, texture_of
from smarttac_can.science.control.vibration import Limit
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import Drive, Measurement
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.textures import Axis, TextureTable

REGULATING = (Mode.AMPLITUDE, Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
PROFILE = TextureTable(Axis.TIME, False, 0, 1000, tuple(range(3000, 3100)))
LAWS = list(VibrationLaw)
LIMITS = CascadeParameters(V_max=40.0, W_max=2e-6, f_min=43000.0, f_max=43800.0)

anything = st.floats(allow_nan=True, allow_infinity=True)
likely = st.floats(-3e-6, 3e-6)
force = st.floats(-4.0, 4.0)
measurements = st.builds(
    Measurement,
    st.builds(complex, likely | anything, likely | anything),
    st.tuples(*[force | anything] * 6),
    anything,
    st.integers(0, 127),
)
setpoints = st.builds(
    setpoint,
    st.floats(0.0, 200.0) | anything,
    st.floats(42e3, 45e3) | anything,
    st.floats(0.0, 5e-6) | anything,
    st.floats(0.05, 2.0) | anything,
    st.floats(0.05, 2.0) | anything,
    st.floats(-0.04, 0.04) | anything,
)


def cascade_with_texture(parameters=None, table=GRATING):
    cascade = Cascade(parameters)
    cascade.play(texture_of(table))
    return cascade


@given(
    st.lists(
        st.tuples(st.sampled_from([*Mode, *REGULATING]), measurements, setpoints),
        min_size=1,
        max_size=30,
    )
)
@settings(max_examples=150)
@pytest.mark.parametrize("law", LAWS)
def test_no_drive_leaves_the_limits_whatever_comes_in(law, ticks):
    cascade = cascade_with_texture(replace(LIMITS, vibration_law=law, dead_time=540e-6))
    for mode, measurement, target in ticks:
        cascade.set_mode(mode)
        drive = cascade.update(measurement, target)
        assert 0.0 <= drive.voltage <= 40.0
        assert 43000.0 <= drive.frequency <= 43800.0
        assert drive == cascade.drive
        assert 0.0 <= cascade.W_ref < math.inf
        published = (*cascade.contact, cascade.amplitude, cascade.E, cascade.mu_ref)
        assert all(math.isfinite(value) for value in published)


@pytest.mark.parametrize("mode", [Mode.OPEN_LOOP, *REGULATING, Mode.IDENTIFY])
@pytest.mark.parametrize("law", LAWS)
def test_any_bad_number_of_a_measurement_turns_the_drive_off(law, mode):
    cascade, plate = cascade_with_texture(CascadeParameters(vibration_law=law)), FirstOrderPlate()
    for where, bad in product(range(8), (math.nan, math.inf, -math.inf, 1e200)):
        cascade.set_mode(mode)
        run(cascade, plate, setpoint(voltage=20.0), 3)
        assert cascade.mode is mode
        numbers = [1e-6, 0.0, *gauges(Fn=0.5)]
        numbers[where] = bad
        measurement = Measurement(complex(*numbers[:2]), tuple(numbers[2:]), 20.0, 0)
        assert cascade.update(measurement, setpoint(voltage=20.0)).voltage == 0.0
        assert cascade.mode is Mode.OFF
        assert cascade.reason.endswith("measurement is not finite")


@pytest.mark.parametrize("where", range(6))
def test_a_bad_setpoint_turns_the_drive_off(where):
    cascade, plate = begun(Mode.FRICTION, 10)
    values = list(setpoint())
    values[where] = math.nan
    assert cascade.update(plate.measure(), setpoint(*values)).voltage == 0.0
    assert (cascade.mode, cascade.reason) == (Mode.OFF, "set-point is not finite")


@pytest.mark.parametrize("side", ["mu_left", "mu_right"])
@pytest.mark.parametrize("wrong", [0.0, -0.3, 5e-324, 1e-6, 1e6, 1e306])
def test_friction_reference_of_zero_or_nan_turns_the_drive_off(side, wrong):
    cascade, plate = Cascade(), FirstOrderPlate()
    assert not any(cascade.contact)
    cascade.set_mode(Mode.FRICTION)
    assert cascade.update(plate.measure(), setpoint(**{side: wrong})).voltage == 0.0
    assert (cascade.mode, cascade.reason) == (Mode.OFF, "COF reference is not above 0")


@pytest.mark.parametrize("doubt", [{"kappa": math.nan}, {"rate": math.inf}, {"w0": math.nan}])
def test_learned_nan_turns_the_drive_off_or_restores_the_model(doubt):
    cascade, plate = begun(Mode.AMPLITUDE, 20, vibration_law=VibrationLaw.PREDICTIVE)
    learned = cascade.state.learned
    learned = learned._replace(belief=learned.belief._replace(**doubt))
    cascade._state = cascade.state._replace(learned=learned)
    drives = run(cascade, plate, setpoint(), 30)
    assert all(0.0 <= drive.voltage <= 150.0 for drive in drives)
    assert cascade.mode is Mode.OFF or abs(plate.W) == pytest.approx(1e-6, rel=0.02)


def flat(numbers):
    return [n for item in numbers for n in (item if isinstance(item, tuple) else (item,))]


@pytest.mark.parametrize("fails", ["measurement", "drive"])
def test_a_fault_leaves_nothing_of_its_tick(fails):
    finger = Finger()
    cascade, plate = begun(Mode.FRICTION, 20, forces=finger.touch)
    plan, state, measurement = cascade.plan, cascade.state, plate.measure(finger.touch(plate.W))
    if fails == "measurement":
        measurement = measurement._replace(W=complex(math.nan, 0.0))
    else:
        plan = plan._replace(bare=plan.bare._replace(amplitude=math.nan))
    off, controlled = control_step(plan, state, Mode.FRICTION, measurement, setpoint())
    assert (off.mode, off.W_ref) == (Mode.OFF, 0.0)
    assert off.drive == (0.0, state.drive.frequency)
    assert FAULTS[controlled.fault] == f"{fails} is not finite"
    assert not any((controlled.mu_ref, controlled.E, controlled.limited))
    if fails == "measurement":
        assert not any(flat(controlled._replace(fault=0)))


@pytest.mark.parametrize("way", [(1.0, 0.0), (0.0, 1.0), (0.6, 0.8)])
def test_a_finger_turns_when_its_lateral_force_does(way):
    cascade, plate = begun(Mode.FRICTION, law=Law.PREDICTIVE)
    for side in (1.0, -1.0):
        Fx, Fy = (0.2 * side * share for share in way)
        run(cascade, plate, setpoint(), 10, lambda W, f=(Fx, Fy): gauges(*f, 0.5))
        assert cascade.state.sliding.since_turn == 9


def test_friction_law_uses_the_published_cof():
    cascade, plate = begun(Mode.FRICTION, law=Law.PREDICTIVE)
    assert cascade.W_ref == 0.0
    run(cascade, plate, setpoint(), 30, lambda W: gauges(0.2, 0.1, 0.5))
    contact = cascade.contact
    sample = (contact.mu, contact.u_mu, contact.Fx, contact.Fy, cascade.amplitude, cascade.mu_ref)
    assert cascade.state.sliding.sample == (*sample, contact.position, contact.speed)
    run(cascade, plate, setpoint(mu_left=0.0), 1, Finger().touch)
    assert cascade.mode is Mode.OFF
    # A reference that no law follows is no fault.
    cascade.set_mode(Mode.AMPLITUDE)
    run(cascade, plate, setpoint(mu_left=0.0, mu_right=0.0), 5)
    assert cascade.mode is Mode.AMPLITUDE
    cascade.set_mode(Mode.IDENTIFY)
    run(cascade, plate, setpoint(), 1)
    assert cascade.W_ref == 0.0


def test_without_contact_no_force_loads_the_model():
    law = VibrationLaw.PREDICTIVE
    cascade, _ = begun(Mode.AMPLITUDE, 20, forces=lambda W: gauges(Fn=0.05), vibration_law=law)
    assert cascade.state.learned.contact == 0.0


def test_frequency_of_a_driven_plate_alone_is_slew_limited():
    cascade, plate = begun(Mode.AMPLITUDE, 3, setpoint(frequency=43390.0, amplitude=0.0))
    assert cascade.drive.voltage == 0.0
    run(cascade, plate, setpoint(frequency=43200.0), 1)
    assert cascade.drive.frequency == 43200.0
    run(cascade, plate, setpoint(frequency=43200.0, amplitude=0.02e-6), 20)
    assert 0.0 < cascade.drive.voltage < 1.0
    run(cascade, plate, setpoint(frequency=43250.0, amplitude=0.02e-6), 1)
    assert cascade.drive.frequency == 43200.0 + FREQUENCY_STEP
    run(cascade, plate, setpoint(frequency=43200.0), 20)
    drives = run(cascade, plate, setpoint(frequency=43290.0), 30)
    steps = [after.frequency - before.frequency for before, after in pairwise(drives)]
    assert 0.0 <= min(steps) <= max(steps) == FREQUENCY_STEP
    assert drives[-1].frequency == 43290.0
    # 3 % of half the width of the resonance, or so.
    assert 0.02 < FREQUENCY_STEP * 2.0 * math.pi * PlateModel().tau < 0.04


def test_the_reason_lasts_until_another_mode_is_chosen():
    cascade, plate = Cascade(), FirstOrderPlate()
    cascade.update(Measurement(complex(math.nan, 0.0), gauges(), 20.0, 0), setpoint())
    run(cascade, plate, setpoint(), 3)
    assert cascade.reason
    cascade.set_mode(Mode.AMPLITUDE)
    assert cascade.reason == ""


def test_there_is_no_such_mode():
    cascade = Cascade()
    with pytest.raises(ValueError, match=r"^7 is not a valid Mode$"):
        cascade.set_mode(7)
    assert cascade.mode is Mode.OFF


@pytest.mark.parametrize("mode", [Mode.OPEN_LOOP, *REGULATING, Mode.IDENTIFY])
def test_off_is_at_once(mode):
    cascade, plate = cascade_with_texture(), FirstOrderPlate()
    cascade.set_mode(mode)
    run(cascade, plate, setpoint(voltage=20.0), 150)
    assert cascade.drive.voltage > 0.0
    cascade.set_mode(Mode.OFF)
    assert cascade.drive.voltage == 0.0
    assert (cascade.mu_ref, cascade.E, cascade.limited) == (0.0, 0.0, 0)
    assert cascade.update(plate.measure(), setpoint(voltage=20.0)).voltage == 0.0
    assert (cascade.W_ref, cascade.mu_ref, cascade.E, cascade.limited) == (0.0, 0.0, 0.0, 0)


@given(
    before=st.sampled_from([Mode.OPEN_LOOP, *REGULATING]),
    after=st.sampled_from(REGULATING),
    ticks=st.integers(1, 60),
    amplitude=st.floats(0.2e-6, 2e-6),
    detuning=st.floats(-100.0, 100.0),
)
@settings(max_examples=100)
def test_mode_change_moves_the_drive_by_its_new_error_alone(
    before, after, ticks, amplitude, detuning
):
    cascade, plate, finger = cascade_with_texture(), FirstOrderPlate(), Finger()
    target = setpoint(voltage=15.0, frequency=43390.0 + detuning, amplitude=amplitude)
    cascade.set_mode(before)
    old = run(cascade, plate, target, ticks, finger.touch)[-1]
    if before is after:
        return
    cascade.set_mode(after)
    new = cascade.update(plate.measure(finger.touch(plate.W)), target)
    gains, contact = cascade.plan.bare, cascade.contact
    Kp = gains.amplitude
    if after is Mode.TEXTURE and contact.touching:
        Kp = cascade.plan.rows[row_of(contact.Fn, len(cascade.plan.rows))][0]
    assert abs(new.voltage - old.voltage) <= Kp * abs(cascade.W_ref - abs(plate.W)) + 1e-9
    if after is not Mode.AMPLITUDE:
        tangent = plate.W.imag / plate.W.real if plate.W else 0.0
        bound = abs(gains.resonance * tangent)
        assert abs(new.frequency - old.frequency) <= bound + 1e-9


def test_mode_change_to_resonance_keeps_the_frequency_in_force():
    cascade, plate = begun(Mode.AMPLITUDE_RESONANCE, 60, setpoint(frequency=43250.0))
    assert cascade.limited == 0
    cascade.set_mode(Mode.FRICTION)
    drive = cascade.update(plate.measure(), setpoint(frequency=43250.0))
    assert drive.frequency == pytest.approx(43390.0, abs=0.1)


def test_open_loop_is_the_setpoint_within_limits():
    cascade, plate = Cascade(LIMITS), FirstOrderPlate()
    cascade.set_mode(Mode.OPEN_LOOP)
    assert cascade.update(plate.measure(), setpoint(12.5, 43333.0)) == Drive(12.5, 43333.0)
    assert cascade.limited == 0
    assert cascade.update(plate.measure(), setpoint(41.0, 43900.0)) == Drive(40.0, 43800.0)
    assert cascade.limited == Limit.VOLTAGE | Limit.FREQUENCY


def test_open_loop_is_cut_to_the_limit_of_the_bare_plate():
    cascade, plate = Cascade(LIMITS, PlateModel(gain=80e-9)), FirstOrderPlate()
    cascade.set_mode(Mode.OPEN_LOOP)
    assert cascade.update(plate.measure(), setpoint(25.0)).voltage == 25.0, "80 nm/V: 2 um"
    assert cascade.limited == 0
    drive = cascade.update(plate.measure(), setpoint(25.1))
    assert drive.voltage == pytest.approx(25.0, rel=1e-12)
    assert cascade.limited == Limit.AMPLITUDE
    drive = cascade.update(plate.measure(), setpoint(150.0))
    assert drive.voltage == pytest.approx(25.0, rel=1e-12)
    assert cascade.limited == Limit.AMPLITUDE | Limit.VOLTAGE


def test_limits_of_the_amplitude_loop_are_told():
    cascade, plate = Cascade(LIMITS), FirstOrderPlate()
    cascade.set_mode(Mode.AMPLITUDE)
    cascade.update(plate.measure(), setpoint(amplitude=2.5e-6))
    assert cascade.W_ref == 2e-6
    assert cascade.limited == Limit.AMPLITUDE | Limit.VOLTAGE
    run(cascade, plate, setpoint(amplitude=1.5e-6), 30)
    assert cascade.limited == 0


def test_configure_is_bumpless_and_takes_effect():
    cascade, plate = begun(Mode.AMPLITUDE_RESONANCE)
    old = run(cascade, plate, setpoint(), 60)[-1]
    cascade.configure(CascadeParameters(amplitude_pole=0.6, V_max=25.0))
    new = run(cascade, plate, setpoint(), 30)
    assert [drive.voltage for drive in new] == pytest.approx([old.voltage] * 30, abs=1e-6)
    errors = []
    for _ in range(5):
        errors.append(1.1e-6 - abs(plate.W))
        run(cascade, plate, setpoint(amplitude=1.1e-6), 1)
    assert errors[3] / errors[2] == pytest.approx(0.6, abs=0.01)
    run(cascade, plate, setpoint(amplitude=3e-6), 50)
    assert cascade.drive.voltage == 25.0


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.2])
@pytest.mark.parametrize(
    ("before", "after"), [(one, other) for one in LAWS for other in LAWS if one is not other]
)
def test_another_law_takes_over_without_a_bump(before, after, gain):
    """Also on a plate whose gain is not the model's: neither law was ever told."""
    plate = FirstOrderPlate(PlateModel(gain=50e-9 * gain), dead_time=540e-6)
    cascade = Cascade(CascadeParameters(vibration_law=before, dead_time=540e-6))
    cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
    old = run(cascade, plate, setpoint(), 200)[-1]
    cascade.configure(CascadeParameters(vibration_law=after, dead_time=540e-6))
    new = run(cascade, plate, setpoint(), 60)
    assert cascade.mode is Mode.AMPLITUDE_RESONANCE
    assert [drive.voltage for drive in new] == pytest.approx([old.voltage] * 60, rel=2e-3)
    assert [drive.frequency for drive in new] == pytest.approx([old.frequency] * 60, abs=0.5)


def test_configure_ends_an_identification():
    cascade, _ = begun(Mode.IDENTIFY, 150)
    cascade.configure(LIMITS)
    assert cascade.identification.failure == cascade.reason
    assert cascade.drive.voltage == 0.0
    assert (cascade.mode, cascade.reason) == (
        Mode.OFF,
        "identification: parameters were changed",
    )


def test_the_same_parameters_change_nothing():
    cascade, _ = begun(Mode.IDENTIFY, 150)
    cascade.configure(CascadeParameters())
    assert cascade.mode is Mode.IDENTIFY


def test_new_plan_keeps_the_loops_to_the_bit_unless_redesigned():
    drives = []
    for changed in (
        CascadeParameters(),
        CascadeParameters(V_max=140.0, f_max=43950.0, slope=0.05e-6, hysteresis=2e-3),
        CascadeParameters(amplitude_pole=0.6),
    ):
        cascade, plate = Cascade(), FirstOrderPlate()
        cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
        run(cascade, plate, setpoint(), 5)
        cascade.configure(changed)
        drives.append(run(cascade, plate, setpoint(), 30))
    assert drives[1] == drives[0]
    assert drives[2] != drives[0]


def test_adopted_model_is_designed_for():
    cascade = Cascade(model=PlateModel(gain=100e-9))
    assert cascade.model.gain == 100e-9
    cascade.adopt(PlateModel())
    assert cascade.model == PlateModel()
    plate = FirstOrderPlate()
    cascade.set_mode(Mode.AMPLITUDE)
    run(cascade, plate, setpoint(), 2)
    assert abs(plate.W) == pytest.approx(0.96e-6)


def test_identification_is_kept_with_its_temperature_and_load():
    cascade, plate = Cascade(model=PlateModel(load=1.3)), FirstOrderPlate()
    cascade.set_mode(Mode.IDENTIFY)
    while cascade.mode is Mode.IDENTIFY:
        measurement = plate.measure()._replace(temperature=31.5)
        plate.step(cascade.update(measurement, setpoint()))
    assert cascade.model.f0 == pytest.approx(43390.0, abs=1.0)
    assert (cascade.model.temperature, cascade.model.load) == (31.5, 1.3)


MU_REF = 0.42


def friction_loop(law, mu0=0.6, noise=0.0):
    """COFs over the second half of a run with the finger left of the boundary."""
    cascade, plate = begun(Mode.FRICTION, law=law)
    finger, shake, cofs = Finger(mu0), random.Random(1), []

    def touch(W):
        return tuple(s + shake.gauss(0.0, noise) for s in finger.touch(W, x=-0.01))

    for _ in range(2000):
        run(cascade, plate, setpoint(mu_left=MU_REF), 1, touch)
        cofs.append(finger.friction(plate.W))
    assert cascade.mode is Mode.FRICTION
    assert cascade.mu_ref == MU_REF
    return cofs[1000:]


@pytest.mark.parametrize(
    ("law", "mu0", "noise", "mean", "spread"),
    [
        *((Law.MEASURED, mu0, 0.0, 1e-3, 1e-3) for mu0 in (0.58, 0.6, 0.65)),
        *((Law.PREDICTIVE, mu0, 0.0, 1e-3, 1e-3) for mu0 in (0.58, 0.65)),
        # In noise one is right on average, and one is calm.
        (Law.MEASURED, 0.6, 4.3e-3, 0.02, math.inf),
        (Law.PREDICTIVE, 0.6, 4.3e-3, 0.01, 0.06 * MU_REF),
    ],
)
def test_a_law_reaches_the_reference(law, mu0, noise, mean, spread):
    cofs = friction_loop(law, mu0, noise)
    assert statistics.fmean(cofs) == pytest.approx(MU_REF, rel=mean)
    assert max(cofs) - min(cofs) < spread
    assert not noise or law is Law.MEASURED or statistics.stdev(cofs) < 0.01 * MU_REF


def test_law_accumulate_limit_cycles_where_measured_settles():
    cofs = friction_loop(Law.ACCUMULATE)
    assert max(cofs) - min(cofs) > 0.1 * MU_REF
    # It neither decays nor grows.
    assert max(cofs[:500]) == pytest.approx(max(cofs[500:]), rel=0.01)


@pytest.mark.parametrize("mu0", [0.6, 0.7])
def test_law_nominal_leaves_a_static_error(mu0):
    cofs = friction_loop(Law.NOMINAL, mu0)
    error = (cofs[-1] - MU_REF) / MU_REF
    assert abs(error) > 0.05
    # The rest is the error whose step holds the plate where it is.
    finger = Finger(mu0)
    assert finger.friction(1e-6 + 4e-6 * error) == pytest.approx(cofs[-1], rel=1e-3)


@pytest.mark.parametrize("law", list(Law))
def test_another_law_goes_on_from_the_drive_in_force(law):
    finger = Finger()
    cascade, plate = begun(Mode.FRICTION, law=law)
    target = setpoint(mu_left=MU_REF)
    run(cascade, plate, target, 400, lambda W: finger.touch(W, x=-0.01))
    before, W = cascade.drive, abs(plate.W)
    cascade.configure(CascadeParameters(law=Law.PREDICTIVE))
    run(cascade, plate, target, 1, lambda W: finger.touch(W, x=-0.01))
    if law is not Law.PREDICTIVE:
        assert pytest.approx(W, rel=1e-9) == cascade.W_ref
    if law is not Law.ACCUMULATE:
        assert cascade.drive.voltage == pytest.approx(before.voltage, rel=0.01)


def test_learned_state_of_predictive_outlasts_a_change_of_mode():
    finger = Finger()
    cascade, plate = begun(Mode.FRICTION, law=Law.PREDICTIVE)
    for x in (-8e-3, 8e-3) * 2:
        run(cascade, plate, setpoint(), 100, lambda W, x=x: finger.touch(W, x=x))
    learned = cascade.state.sliding.known
    assert learned.pairs > 0
    cascade.configure(replace(cascade.parameters, hysteresis=2e-3))
    assert cascade.state.sliding.known is learned
    cascade.set_mode(Mode.AMPLITUDE_RESONANCE)
    run(cascade, plate, setpoint(), 5, lambda W: finger.touch(W, x=8e-3))
    cascade.set_mode(Mode.FRICTION)
    run(cascade, plate, setpoint(), 1, lambda W: finger.touch(W, x=8e-3))
    assert cascade.state.sliding.known is learned
    assert abs(plate.W) == pytest.approx(cascade.W_ref, rel=0.05)


@pytest.mark.parametrize("law", [Law.MEASURED, Law.PREDICTIVE])
def test_unreachable_reference_is_told(law):
    finger = Finger(mu0=0.6)
    cascade, plate = begun(Mode.FRICTION, law=law)
    run(cascade, plate, setpoint(mu_left=0.9), 200, lambda W: finger.touch(W, x=-0.01))
    assert cascade.W_ref == 0.0
    assert cascade.limited & Limit.AMPLITUDE


def test_out_of_contact_the_amplitude_waits_at_its_nominal_value():
    finger = Finger()
    cascade, plate = begun(Mode.FRICTION, 200, setpoint(amplitude=0.7e-6), forces=finger.touch)
    assert abs(plate.W) > 1e-6
    run(cascade, plate, setpoint(amplitude=0.7e-6), 100, lambda W: gauges(Fx=0.05, Fn=0.02))
    assert abs(plate.W) == pytest.approx(0.7e-6, rel=1e-3)
    assert cascade.E == 0.0
    assert cascade.mu_ref > 0.0


def test_friction_mode_starts_with_the_finger_on_its_side():
    cascade, plate = Cascade(), FirstOrderPlate()
    run(cascade, plate, setpoint(), 50, lambda W: gauges(Fn=0.5, x=-0.4e-3))
    cascade.set_mode(Mode.FRICTION)
    run(cascade, plate, setpoint(), 1, lambda W: gauges(Fn=0.5, x=-0.4e-3))
    assert cascade.mu_ref == 0.3
    cascade.set_mode(Mode.AMPLITUDE)
    # It comes from further right, so its speed is towards the left.
    for x in (0.9e-3, 0.4e-3):
        run(cascade, plate, setpoint(), 50, lambda W, x=x: gauges(Fn=0.5, x=x))
    cascade.set_mode(Mode.FRICTION)
    run(cascade, plate, setpoint(), 1, lambda W: gauges(Fn=0.5, x=0.4e-3))
    assert cascade.mu_ref == 0.4
    # New parameters do not move it to the other side either.
    cascade.configure(CascadeParameters(hysteresis=2e-3))
    run(cascade, plate, setpoint(), 1, lambda W: gauges(Fn=0.5, x=-0.4e-3))
    assert cascade.mu_ref == 0.4


@pytest.mark.parametrize("hysteresis", [1e-3, 4e-3])
def test_the_side_changes_half_a_hysteresis_beyond_the_boundary(hysteresis):
    cascade, plate = begun(Mode.FRICTION, hysteresis=hysteresis)
    there = [hysteresis * (tick / 200 - 1.0) for tick in range(400)]
    seen = []
    for x in there + there[::-1]:
        run(cascade, plate, setpoint(), 1, lambda W, x=x: gauges(Fx=0.2, Fn=0.5, x=x))
        seen.append((cascade.mu_ref, cascade.contact.position))
    changes = [after for before, after in pairwise(seen) if after[0] != before[0]]
    assert changes == [
        (0.4, pytest.approx(0.5 * hysteresis, rel=0.05)),
        (0.3, pytest.approx(-0.5 * hysteresis, rel=0.05)),
    ]


def test_law_accumulate_starts_from_the_amplitude_there_is():
    cascade, plate = begun(Mode.OPEN_LOOP, 60, setpoint(voltage=30.0), law=Law.ACCUMULATE)
    assert cascade.W_ref == pytest.approx(1.5e-6)
    cascade.set_mode(Mode.FRICTION)
    run(cascade, plate, setpoint(mu_left=0.4), 1, lambda W: gauges(Fx=0.2, Fn=0.5, x=-0.01))
    assert cascade.W_ref == pytest.approx(1.5e-6)


def test_two_runs_are_the_same_bits():
    def trace():
        cascade, plate, finger = Cascade(), FirstOrderPlate(noise=1e-9), Finger()
        cascade.set_mode(Mode.FRICTION)
        return run(cascade, plate, setpoint(), 300, finger.touch)

    assert trace() == trace()


@pytest.mark.parametrize("law", [VibrationLaw.PREDICTIVE, VibrationLaw.PI])
def test_a_texture_is_the_reference_where_the_finger_will_be(law):
    parameters = CascadeParameters(vibration_law=law, dead_time=500e-6, preview=1.5e-3)
    cascade, plate = cascade_with_texture(parameters), FirstOrderPlate(dead_time=500e-6)
    speed = 0.0613  # in a second no whole number of periods
    cascade.set_mode(Mode.TEXTURE)
    for tick in range(200):
        forces = gauges(0.35, 0.0, 1.0, speed * 1e-3 * tick)
        plate.step(cascade.update(plate.measure(forces), setpoint()))
    assert cascade.contact.position == pytest.approx(speed * 1e-3 * 199)
    # Under 1 N tau is 0.397 ms. Half of a tick after a drive, 0.778 of the way is covered.
    late = 1e-3 * (1.0 - 0.716 / 0.919)
    ahead = 1e9 * speed * (0.199 + POSITION_LAG + 1.5e-3 + late - SAVED)
    assert cascade.mu_ref == pytest.approx(GRATING.at(ahead), rel=1e-4)
    assert cascade.mu_ref != pytest.approx(GRATING.at(ahead - 30e3), rel=1e-3)
    contact = cascade.contact
    assert 100.0 * (contact.mu - cascade.mu_ref) / cascade.mu_ref == cascade.E
    cascade.set_mode(Mode.AMPLITUDE)
    cascade.update(plate.measure(forces), setpoint())
    assert (cascade.mu_ref, cascade.E) == (0.0, 0.0)


def test_no_friction_law_has_a_part_in_a_texture():
    drives = set()
    for law in Law:
        cascade = cascade_with_texture(CascadeParameters(law=law))
        cascade.set_mode(Mode.TEXTURE)
        drives.add(tuple(run(cascade, FirstOrderPlate(), setpoint(), 100, Finger().touch)))
    assert len(drives) == 1


def test_finger_that_lifts_ends_the_estimate_of_its_position():
    cascade, plate, finger = cascade_with_texture(), FirstOrderPlate(), Finger()
    cascade.set_mode(Mode.TEXTURE)
    run(cascade, plate, setpoint(), 100, finger.touch)
    assert cascade.state.playing.touches
    run(cascade, plate, setpoint(amplitude=1.5e-6), 1)
    assert not cascade.state.playing.touches
    assert (cascade.W_ref, cascade.E) == (1.5e-6, 0.0)
    assert cascade.mu_ref == pytest.approx(GRATING.at(1e9 * cascade.contact.position))


def test_mode_texture_without_one_turns_itself_off():
    cascade, plate = begun(Mode.TEXTURE)
    assert cascade.update(plate.measure(), setpoint()).voltage == 0.0
    assert (cascade.mode, cascade.reason) == (Mode.OFF, "there is no texture")


@pytest.mark.parametrize("between", [Mode.AMPLITUDE, Mode.FRICTION])
def test_profile_starts_with_the_mode_and_runs_without_a_finger(between):
    cascade, plate = (
        cascade_with_texture(CascadeParameters(preview=0.0), PROFILE),
        FirstOrderPlate(),
    )
    references = []
    for mode in [Mode.TEXTURE] * 5 + [between] * 5 + [Mode.TEXTURE] * 5:
        cascade.set_mode(mode)
        run(cascade, plate, setpoint(), 1)
        references.append(round(1e4 * cascade.mu_ref) if mode is Mode.TEXTURE else 0)
    assert references == [*range(3000, 3005), *[0] * 5, *range(3000, 3005)]
    assert cascade.W_ref == 1e-6, "the set-point's amplitude, while nobody touches"


def test_another_profile_begins_at_once_from_its_start():
    cascade, plate = Cascade(CascadeParameters(preview=0.0)), FirstOrderPlate()
    assert (cascade.limited, cascade.mu_ref, cascade.E) == (0, 0.0, 0.0)
    cascade.play(texture_of(PROFILE))
    cascade.set_mode(Mode.TEXTURE)
    references = []
    for ticks in (7, 3):
        cascade.play(texture_of(PROFILE))
        for _ in range(ticks):
            run(cascade, plate, setpoint(), 1)
            references.append(round(1e4 * cascade.mu_ref))
    assert references == [*range(3000, 3007), *range(3000, 3003)]


@pytest.mark.parametrize("mode", [Mode.AMPLITUDE, Mode.IDENTIFY])
def test_cut_voltage_sets_the_limit_bit_and_ends_identification(mode):
    cascade, plate = begun(mode)
    while not cascade.drive.voltage:
        run(cascade, plate, setpoint(), 1)
    cascade.realised(cascade.drive)
    assert not cascade.limited & Limit.AMPLITUDE
    cut = cascade.drive._replace(voltage=0.5 * cascade.drive.voltage)
    cascade.realised(cut)
    assert cascade.drive == cut
    assert cascade.limited & Limit.AMPLITUDE
    found = cascade.identification
    assert found is None or " V were cut to " in found.failure
    assert (found is None) == (mode is Mode.AMPLITUDE)


def test_identification_of_a_tared_plate_waits_for_its_start():
    cascade, plate = Cascade(), FirstOrderPlate()
    cascade.zero = (0.0,) * 6
    cascade.set_mode(Mode.AMPLITUDE)
    run(cascade, plate, setpoint(), 10)
    cascade.set_mode(Mode.IDENTIFY)
    cascade.realised(cascade.drive._replace(voltage=0.0))
    run(cascade, plate, setpoint(), 3)
    assert cascade.mode is Mode.IDENTIFY


@pytest.mark.parametrize("mode", [Mode.AMPLITUDE, Mode.OFF])
def test_an_identification_ends_with_another_mode_and_says_so(mode):
    cascade, plate = Cascade(), FirstOrderPlate()
    # Before its first tick there is nothing to end.
    cascade.set_mode(Mode.IDENTIFY)
    cascade.set_mode(mode)
    assert cascade.mode is mode
    cascade.set_mode(Mode.IDENTIFY)
    run(cascade, plate, setpoint(), 3)
    cascade.set_mode(mode)
    assert cascade.identification.failure == (
        "turned off" if mode is Mode.OFF else "another mode was chosen"
    )
    run(cascade, plate, setpoint(), 3)
    assert cascade.mode is mode


def test_a_profile_goes_on_alike_with_a_finger_and_without():
    references = []
    for forces in (None, lambda W: gauges(Fx=0.2, Fn=0.5)):
        cascade, plate = cascade_with_texture(table=PROFILE), FirstOrderPlate()
        cascade.set_mode(Mode.TEXTURE)
        found = []
        for _ in range(30):
            run(cascade, plate, setpoint(), 1, forces)
            found.append(cascade.mu_ref)
        references.append(found)
    assert references[0] == references[1]
