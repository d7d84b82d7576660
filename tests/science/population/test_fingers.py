import numpy as np
import pytest

from smarttac_can.science.plant.friction import sliding_coefficient
from smarttac_can.science.population.fingers import (
    CASES,
    F0,
    MODEL_PLATE,
    PLATE_RANGES,
    SPAN,
    STEP,
    W_LEAST,
    W_MOST,
    Case,
    draw_finger,
    draw_plate,
    stroke_of,
)

NOMINAL = CASES["nominal"]
MANY = [draw_finger(3, number, NOMINAL) for number in range(2000)]
RANGES = {
    "mu0": (0.3, 0.9),
    "rho": (0.15, 0.5),
    "W0": (0.8e-6, 3e-6),
    "p": (1.0, 2.0),
    "load_damping": (5.0, 14.0),
    "exponent": (0.7, 1.0),
    "stribeck": (1.0, 1.2),
    "skin_stiffness": (500.0, 2000.0),
    "skin_damping": (0.5, 2.0),
    "relaxation_length": (5e-6, 40e-6),
    "skin_mass": (0.05e-3, 0.2e-3),
}


def coefficient(finger, W):
    return sliding_coefficient(finger.subject, W, finger.speed, finger.force, 0.0, f0=F0)


def test_a_finger_is_a_function_of_seed_and_number():
    assert draw_finger(3, 17, NOMINAL) == MANY[17]
    assert draw_finger(4, 17, NOMINAL) != MANY[17]
    assert len({finger.subject.mu0 for finger in MANY}) == len(MANY)
    assert len({finger.noise_seed for finger in MANY}) > len(MANY) - 5


@pytest.mark.parametrize("name", RANGES)
def test_the_ranges_are_filled_and_kept(name):
    low, high = RANGES[name]
    values = np.array([getattr(finger.subject, name) for finger in MANY])
    assert low <= values.min() < low + 0.05 * (high - low)
    assert high - 0.05 * (high - low) < values.max() <= high


def test_force_and_speed_are_uniform():
    force = np.array([finger.force for finger in MANY])
    speed = np.array([finger.speed for finger in MANY])
    assert np.quantile(force, [0.0, 0.5, 1.0]) == pytest.approx([0.3, 0.6, 0.9], abs=0.02)
    assert np.quantile(speed, [0.0, 0.5, 1.0]) == pytest.approx([0.03, 0.065, 0.1], abs=0.003)


def test_logarithmic_range_has_its_median_at_the_geometric_mean():
    stiffness = [finger.subject.skin_stiffness for finger in MANY]
    assert np.median(stiffness) == pytest.approx(1000.0, rel=0.05)


def test_each_map_spans_uniformly_drawn_references():
    shares = []
    for finger in MANY:
        least, most = coefficient(finger, W_MOST), coefficient(finger, W_LEAST)
        assert most - least >= SPAN
        assert least <= finger.mu_left < finger.mu_right <= most + 1e-12
        assert finger.mu_right - finger.mu_left == pytest.approx(STEP)
        shares.append((finger.mu_left - least) / (most - STEP - least))
    assert np.quantile(shares, [0.25, 0.5, 0.75]) == pytest.approx([0.25, 0.5, 0.75], abs=0.04)


def test_wider_ranges_are_a_tenth_wider_at_both_ends_and_sound():
    values = [draw_finger(3, number, CASES["wider"]).subject for number in range(2000)]
    W0 = [subject.W0 * 1e6 for subject in values]
    assert min(W0) == pytest.approx(0.58, abs=0.05)
    assert max(W0) == pytest.approx(3.22, abs=0.05)
    exponents = [subject.exponent for subject in values]
    assert 2 / 3 <= min(exponents) < 0.68
    assert max(exponents) <= 1.0
    assert min(subject.stribeck for subject in values) >= 1.0


def test_coupled_finger_of_more_damping_slips_at_less_amplitude():
    coupled = [draw_finger(3, number, CASES["coupled"]).subject for number in range(2000)]

    def correlation(name, subjects):
        pairs = [(subject.load_damping, getattr(subject, name)) for subject in subjects]
        ranks = np.argsort(np.argsort(np.array(pairs), axis=0), axis=0)
        return np.corrcoef(ranks.T)[0, 1]

    assert correlation("W0", [finger.subject for finger in MANY]) == pytest.approx(0.0, abs=0.06)
    assert correlation("W0", coupled) == pytest.approx(-0.78, abs=0.05)
    assert correlation("skin_mass", coupled) == pytest.approx(0.0, abs=0.06)
    W0 = [subject.W0 * 1e6 for subject in coupled]
    assert 0.8 <= min(W0) < 0.82
    assert 2.9 < max(W0) <= 3.0


def test_a_coupling_of_nothing_draws_the_nominal_finger():
    assert pytest.approx(MANY[17].subject.W0) == draw_finger(3, 17, Case(coupling=1e-12)).subject.W0
    damped, W0 = (
        [getattr(draw_finger(3, n, Case(coupling=1.0)).subject, name) for n in range(50)]
        for name in ("load_damping", "W0")
    )
    assert np.argsort(damped).tolist() == np.argsort(W0)[::-1].tolist()


def test_cases_change_the_finger_they_are_named_for():
    assert draw_finger(3, 0, CASES["stribeck"]).subject.stribeck == 1.5
    sweating = draw_finger(3, 0, CASES["sweating"]).subject
    # Of a first-order rise: 5 % a second at its beginning.
    assert sweating.occlusion / sweating.occlusion_time == pytest.approx(0.05)
    assert draw_finger(3, 0, Case()) == MANY[0]


def test_passes_vary_as_the_case_says():
    for name, bound in (("nominal", 0.2), ("uneven", 0.5)):
        forces = [
            now.Fn / finger.force
            for finger in MANY[:60]
            for now in stroke_of(finger, CASES[name]).passes(16)
        ]
        assert 1.0 - bound <= min(forces) < 1.0 - 0.95 * bound
        assert 1.0 + 0.95 * bound < max(forces) <= 1.0 + bound


def test_the_first_passes_are_the_same_whatever_was_asked_before():
    stroke, other = stroke_of(MANY[0], NOMINAL), stroke_of(MANY[0], NOMINAL)
    stroke.at(20.0)
    assert stroke.passes(5) == other.passes(5)
    assert len(other.passes(16)) == 16


def drawn_of(plate):
    """Return the drawn values of a plate that is varied, by the names of the ranges."""
    of, sound = plate.resonator, MODEL_PLATE.resonator
    return {
        "softening": of.softening,
        "neighbour_share": of.neighbour_share,
        "neighbour_offset": abs(of.neighbour_offset),
        "pickup_window": plate.window,
        "tau": of.tau / sound.tau,
        "gain": of.gain / sound.gain,
        "temperature": plate.ambient,
        "dead_time_error": plate.excess - 0.5 * plate.window,
    }


def test_the_ranges_of_the_plates_are_filled_and_kept():
    plates = [draw_plate(3, number, "varied") for number in range(1000)]
    for name, (low, high) in PLATE_RANGES.items():
        values = [drawn_of(plate)[name] for plate in plates]
        more = 1e-9 * (high - low)
        assert low - more <= min(values) < low + 0.05 * (high - low), name
        assert high - 0.05 * (high - low) < max(values) <= high + more, name
    below = sum(plate.resonator.neighbour_offset < 0.0 for plate in plates)
    assert below == pytest.approx(500, abs=60)


def test_drawn_window_that_is_too_short_for_a_pick_up_is_none():
    assert draw_plate(1, 243, "varied").window == 0.0


def test_drawn_plate_follows_seed_and_number():
    varied, identified = (draw_plate(3, 17, name) for name in ("varied", "identified"))
    assert varied == draw_plate(3, 17, "varied")
    assert varied.resonator != draw_plate(4, 17, "varied").resonator
    assert identified.resonator == varied.resonator
    assert varied.model == MODEL_PLATE.model
    model, plate = identified.model, identified.resonator
    assert (model.gain, model.tau) == (plate.gain, plate.tau)
    assert model.softening == plate.softening
    assert identified.excess == 0.5 * identified.window
    assert draw_plate(3, 17, "model") == MODEL_PLATE
