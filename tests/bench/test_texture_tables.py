"""A table of 4096 values holds means: finer detail is averaged away, and reported."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from smarttac_can.bench import Stimulator, Texture
from smarttac_can.vocabulary.textures import MAX_VALUES


def values(texture: Texture) -> np.ndarray:
    return np.array(texture.table.values) / 1e4


def picture(row: np.ndarray, folder: Path) -> Path:
    path = folder / "row.png"
    Image.fromarray(row[None].astype(np.uint8)).save(path)
    return path


LOST = r"^\d+% of the swing of the COF \(as a standard deviation\) is averaged away: it is finer th"


@pytest.mark.parametrize("count", [4097, 5000, 6144, 8192, 12_288, 65_535])
def test_alternating_pixels_become_their_mean(count: int, tmp_path: Path) -> None:
    row = np.zeros(count)
    row[::2] = 255
    path = picture(row, tmp_path)
    with pytest.warns(UserWarning, match=LOST):
        texture = Texture.from_picture(path, 0, 0.3, 0.4)
    # No beat of pixels with values: over 1 mm, 54 values, the mean of both colours.
    means = np.convolve(values(texture), np.ones(54) / 54, "valid")
    assert means == pytest.approx(0.35, abs=2e-3)
    with pytest.raises(ValueError, match=LOST):
        Texture.from_picture(path, 0, 0.3, 0.4, strict=True)


@pytest.mark.parametrize("count", [10, 4096, 8192, 50_000])
def test_wide_picture_keeps_the_mean_of_its_columns(count: int, tmp_path: Path) -> None:
    places = (np.arange(count) + 0.5) / count
    row = np.round(127.5 + 127.5 * np.sin(2 * np.pi * places))
    texture = Texture.from_picture(picture(row, tmp_path), 0, 0.3, 0.4, strict=True)
    at = np.linspace(-30, 30, 200)
    wanted = 0.35 + 0.05 * np.sin(2 * np.pi * (at + 38) / 76)
    assert texture.cof(at) == pytest.approx(wanted, abs=3e-3)
    assert min(texture.table.values) >= 3000
    assert max(texture.table.values) <= 4000


def test_each_value_of_a_wide_picture_is_the_mean_of_its_pixels(tmp_path: Path) -> None:
    row = np.random.default_rng(3).integers(0, 256, 3 * MAX_VALUES)
    with pytest.warns(UserWarning, match=r"^4\d% of the swing"):
        texture = Texture.from_picture(picture(row, tmp_path), 0, 0.3, 0.4)
    means = 0.3 + 0.1 * row.reshape(-1, 3).mean(axis=1) / 255
    assert values(texture) == pytest.approx(means, abs=0.51e-4)


@pytest.mark.parametrize("spacing", [0.002, 0.01, 0.02, 0.03, 0.0333])
def test_alternating_samples_over_position_become_their_mean(spacing: float) -> None:
    x = np.arange(-30.0, 30.0, spacing)
    cof = np.where(np.arange(len(x)) % 2, 0.3, 0.4)
    with pytest.warns(UserWarning, match=LOST):
        texture = Texture.over_position(x, cof)
    inside = values(texture)[5:-5]
    means = np.convolve(inside, np.ones(20) / 20, "valid")
    assert means == pytest.approx(0.35, abs=3e-3)
    with pytest.raises(ValueError, match=LOST):
        Texture.over_position(x, cof, strict=True)


def test_samples_at_the_step_are_kept_as_they_are() -> None:
    cof = np.random.default_rng(4).integers(2000, 6000, 401) / 1e4
    texture = Texture.over_position(np.linspace(-10, 10, 401), cof, strict=True)
    assert values(texture) == pytest.approx(cof, abs=1e-9)
    assert (texture.table.start, texture.table.step) == (-10_000_000, 50_000)
    timed = Texture.over_time(np.arange(401) * 1e-3, cof, strict=True)
    assert values(timed) == pytest.approx(cof, abs=1e-9)


def test_samples_at_half_of_the_step_count_half_on_each_side() -> None:
    x = np.arange(-400, 401) * 0.025
    cof = 0.3 + 0.001 * x
    texture = Texture.over_position(x, cof, strict=True)
    at = np.linspace(-9.5, 9.5, 77)
    assert texture.cof(at) == pytest.approx(0.3 + 0.001 * at, abs=0.6e-4)


def test_rest_at_one_place_weighs_no_more_than_a_pass() -> None:
    there = np.arange(-10.0, 10.0, 0.05)
    x = np.concatenate([there, np.full(5000, 0.02), there[::-1]])
    cof = np.concatenate([np.full(400, 0.3), np.full(5000, 0.5), np.full(400, 0.3)])
    with pytest.warns(UserWarning, match=LOST):
        texture = Texture.over_position(x, cof)
    assert texture.cof([-5.0, 5.0]) == pytest.approx(0.3)
    assert texture.cof(0.0)[0] == pytest.approx(0.4, abs=0.101)


@pytest.mark.parametrize("rate", [1500.0, 6000.0, 7777.0])
def test_alternating_samples_over_time_become_their_mean(rate: float) -> None:
    t = np.arange(0, 3.0, 1 / rate)
    cof = np.where(np.arange(len(t)) % 2, 0.3, 0.4)
    with pytest.warns(UserWarning, match=r"% of the swing .* it is finer than the step of 1 ms"):
        texture = Texture.over_time(t, cof)
    means = np.convolve(values(texture)[3:-3], np.ones(20) / 20, "valid")
    assert means == pytest.approx(0.35, abs=3e-3)


def test_long_profile_of_points_is_averaged_not_picked() -> None:
    points = [(k * 1e-3, 0.3 + 0.1 * (k % 3 == 0)) for k in range(12_285)]
    with pytest.warns(UserWarning, match=r"% of the swing .* the step of 3 ms"):
        texture = Texture.profile(points)
    assert values(texture)[1:-1] == pytest.approx(0.3333, abs=2e-4)
    with pytest.raises(ValueError, match=LOST):
        Texture.profile(points, repeats=True, strict=True)


def test_last_cof_of_a_long_profile_is_held() -> None:
    texture = Texture.profile([(0, 0.3), (100.0, 0.3), (100.0, 0.5), (100.02, 0.5)])
    assert texture.cof(200.0) == pytest.approx(0.5)


def test_table_step_is_kept_and_cut_detail_is_reported() -> None:
    x = np.linspace(-38, 38, 7601)
    cof = 0.35 + 0.05 * np.sin(2 * np.pi * x / 4)
    cut = "every 0.01 mm holds -20.48..20.47 mm of -38..38 mm, .*: step_mm=0.0186 holds all$"
    with pytest.warns(UserWarning, match=cut):
        texture = Texture.over_position(x, cof, step_mm=0.01)
    assert texture.table.step == 10_000
    at = np.linspace(-20, 20, 99)
    assert texture.cof(at) == pytest.approx(0.35 + 0.05 * np.sin(2 * np.pi * at / 4), abs=1e-3)
    with pytest.raises(ValueError, match=cut):
        Texture.over_position(x, cof, step_mm=0.01, strict=True)
    assert Texture.over_position(x, cof, step_mm=0.0186, strict=True).table.step == 18_600
    one_side = Texture.over_position(x[x > 0], cof[x > 0], step_mm=0.01, strict=True)
    assert one_side.table.start == 10_000


def test_texture_frequency_includes_averaged_detail(tmp_path: Path) -> None:
    row = np.zeros(8192)
    row[::2] = 255
    with pytest.warns(UserWarning, match=LOST):
        texture = Texture.from_picture(picture(row, tmp_path), 0, 0.3, 0.4)
    assert texture.frequency(50.0) == pytest.approx(8192 / 2 / 76 * 50, rel=0.01)
    x = np.arange(-30, 30, 0.002)
    with pytest.warns(UserWarning, match=LOST):
        fine = Texture.over_position(x, 0.35 + 0.05 * np.sin(2 * np.pi * x / 0.04))
    assert fine.frequency(50.0) == pytest.approx(1250.0, rel=0.02)
    t = np.arange(0, 3, 1 / 6000)
    with pytest.warns(UserWarning, match=LOST):
        timed = Texture.over_time(t, 0.35 + 0.05 * np.sin(2 * np.pi * 700 * t))
    assert timed.frequency(50.0) == pytest.approx(700.0, rel=0.02)
    with Stimulator.simulate("local") as bench:
        with pytest.warns(UserWarning, match=r"^half of the texture is above 1250 Hz at 50 mm/s"):
            bench.texture = fine
        assert bench.texture == fine


def test_scatter_of_a_steady_finger_is_no_loss() -> None:
    draw = np.random.default_rng(5)
    x = draw.uniform(-10, 10, 4000)
    texture = Texture.over_position(x, draw.normal(0.35, 0.004, 4000), strict=True)
    assert values(texture).std() < 0.004


def test_arrays_back_and_forth_with_gaps_and_nan() -> None:
    x = 12.0 * np.sin(np.linspace(0, 20, 5000))
    cof = 0.3 + 0.01 * x
    cof[::7] = np.nan
    x[(x > 2) & (x < 4)] = np.nan
    texture = Texture.over_position(np.ma.masked_less(x, -11.0), cof)
    at = np.linspace(-10, 11, 60)
    assert texture.cof(at) == pytest.approx(0.3 + 0.01 * at, abs=1e-3)


def test_arrays_over_time_start_at_their_first_time() -> None:
    texture = Texture.over_time([5.0, 5.5, 6.0], [0.3, 0.35, 0.4])
    assert texture.is_over_time
    assert texture.cof([0.0, 0.25, 1.0, 9.0]) == pytest.approx([0.3, 0.325, 0.4, 0.4], abs=1e-3)
    again = Texture.over_time([0.0, 1.0], [0.3, 0.4], repeats=True)
    assert again.cof(1.5) == pytest.approx([0.35], abs=1e-3)


def test_recordings_of_two_rates_are_joined_by_time() -> None:
    t_cof, t_x = np.arange(0, 4, 1 / 6000), np.arange(0.5, 3.5, 0.01)
    x = 10 * np.sin(2 * np.pi * 0.5 * t_x)
    true_x = 10 * np.sin(2 * np.pi * 0.5 * t_cof)
    cof = 0.35 + 0.05 * np.sin(2 * np.pi * true_x / 5)
    texture = Texture.over_position(x, cof, times=(t_x, t_cof))
    at = np.linspace(-9, 9, 60)
    assert texture.cof(at) == pytest.approx(0.35 + 0.05 * np.sin(2 * np.pi * at / 5), abs=2e-3)
    # Where the camera lost the finger, no line is drawn through.
    lost = (t_x > 1.2) & (t_x < 1.7)
    wrong = np.where((t_cof > 1.25) & (t_cof < 1.65), 1.9, cof)
    kept = Texture.over_position(x[~lost], wrong, times=(t_x[~lost], t_cof))
    assert max(kept.table.values) < 4100


@pytest.mark.parametrize(
    ("x", "cof", "more", "reason"),
    [
        ([1, 2], [0.3], {}, "x_mm and cof differ in length: 2 and 1"),
        ([[1, 2]], [0.3], {}, "x_mm of shape (1, 2) are no numbers in a row"),
        (["a"], [0.3], {}, "x_mm are no numbers: "),
        ([1, np.inf], [0.3, 0.3], {}, "x_mm 1 is infinite"),
        ([np.nan, 1], [0.3, np.nan], {}, "x_mm and cof have no sample in common"),
        ([-0.01, 0.01], [0.3, 0.3], {}, "positions -0.01..0.01 mm give a table of 1 at a step of"),
        ([50, 60], [0.3, 0.3], {}, "positions 50..60 mm are all beside the plate, -38..38 mm: cou"),
        ([0, 101], [0.3, 0.3], {}, "sample 1: position 101 mm is outside ±100 mm"),
        ([0, 1], [0.3, 3], {}, "sample 1: COF 3 is outside 0.05..2; leave out rows where the fing"),
        ([0, 1], [0.3, 0.4], {"step_mm": 0.001}, "step_mm 0.001 is outside 0.01..10"),
        ([0, 1], [0.3, 0.4], {"times": [0, 1]}, "times are a pair: the times in s of x_mm, and th"),
        ([0, 1], [0.3, 0.4], {"times": ([0], [0, 1])}, "times of x_mm and x_mm differ in length:"),
        ([0, 1], [0.3, 0.4], {"times": ([1, 0], [0, 1])}, "the times of the positions are fewer t"),
        ([0, 1], [0.3, 0.4], {"times": ([0, 1], [7, 8])}, "the recordings do not overlap: positio"),
    ],
)
def test_arrays_of_no_texture_are_refused(x, cof, more, reason: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=f"^{re.escape(reason)}"):
        Texture.over_position(x, cof, **more)


@pytest.mark.parametrize(
    ("t", "cof", "reason"),
    [
        ([1, 0], [0.3, 0.3], "the times of a profile are below 0, or fall"),
        ([], [], "a profile goes through 2 points (time in s, COF) or more, not 0"),
        ([0, 1, 2], [0.3, 0.01, 0.3], "sample 1: COF 0.01 is outside 0.05..2"),
        ([0, 40_001], [0.3, 0.3], "length of the profile in s 40001 is outside 0..40000"),
    ],
)
def test_times_of_no_texture_are_refused(t, cof, reason: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match=f"^{re.escape(reason)}"):
        Texture.over_time(t, cof)
