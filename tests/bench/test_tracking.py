import numpy as np
import pytest

from smarttac_can.bench import Texture, track

SINE = Texture.grating(2.0, 0.3, 0.4, shape="sine")
SQUARE = Texture.grating(2.0, 0.3, 0.4)


def strokes(passes: int = 4) -> np.ndarray:
    there = np.arange(-12.0, 12.0, 0.06)
    return np.concatenate([there if n % 2 == 0 else there[::-1] for n in range(passes)])


@pytest.mark.parametrize("texture", [SINE, SQUARE])
def test_what_follows_exactly(texture: Texture) -> None:
    x = strokes()
    found = track(texture, x, texture.cof(x))
    assert (found.passes, found.rms) == (4, 0.0)
    assert min(found.correlations) > 0.999
    assert found.mean_correlation > 0.98
    assert found.harmonics[0].per_mm == pytest.approx(0.5)
    assert found.harmonics[0].gain == pytest.approx(1.0, abs=0.01)
    assert found.harmonics[0].error < 0.003


def test_half_of_the_amplitude_a_quarter_of_a_period_late() -> None:
    x = strokes(1)
    half = track(SINE, x, 0.35 + 0.5 * (SINE.cof(x) - 0.35))
    assert min(half.correlations) == pytest.approx(1.0, abs=1e-6)
    assert half.rms == pytest.approx(0.025 / np.sqrt(2), rel=0.01)
    assert half.harmonics[0].gain == pytest.approx(0.5, abs=0.01)
    assert half.harmonics[0].error == pytest.approx(0.025, rel=0.02)
    late = track(SINE, x, SINE.cof(x - 0.5))
    assert min(late.correlations) == pytest.approx(0.0, abs=0.02)
    assert late.harmonics[0].gain == pytest.approx(0.0, abs=0.02)


def test_a_delay_does_not_cancel_between_two_directions() -> None:
    x = strokes()
    ways = np.sign(np.gradient(x))
    found = track(SINE, x, SINE.cof(x - 0.25 * ways))
    assert found.mean_correlation == pytest.approx(np.cos(np.pi / 4), abs=0.03)


def test_a_square_has_its_odd_frequencies() -> None:
    x = strokes()
    frequencies = [h.per_mm for h in track(SQUARE, x, SQUARE.cof(x)).harmonics[:4]]
    assert frequencies == pytest.approx([0.5, 1.5, 2.5, 3.5])


def test_noise_of_a_pass_is_gone_from_the_mean() -> None:
    x = strokes(40)
    noisy = SINE.cof(x) + np.random.default_rng(1).normal(0.0, 0.03, len(x))
    found = track(SINE, x, noisy)
    assert max(found.correlations) < 0.85
    assert found.mean_correlation > 0.98


@pytest.mark.parametrize(
    ("x", "mu", "shapes"),
    [
        (np.zeros(10), np.zeros(9), r"\(10,\), \(9,\)"),
        (np.zeros((2, 9)), np.zeros((2, 9)), r"\(2, 9\)"),
    ],
)
def test_rows_of_unequal_length_are_refused(x: np.ndarray, mu: np.ndarray, shapes: str) -> None:
    with pytest.raises(ValueError, match=f"no two rows of equal length: {shapes}"):
        track(SINE, x, mu)


def test_what_is_not_measured_is_left_out() -> None:
    x = strokes()
    cof = SINE.cof(x)
    cof[::3] = np.nan
    with pytest.raises(ValueError, match=r"^no pass goes from -8 to 8 mm$"):
        track(SINE, x[:100], cof[:100])


def test_time_has_no_place() -> None:
    with pytest.raises(ValueError, match=r"^a texture over time has no place to compare$"):
        track(Texture.profile("step", 0.2, 0.3), [0.0], [0.2])
