"""The true COF follows a texture at the true position, in both directions, with nothing shifted."""

import numpy as np
import pytest
import texture_playing
from texture_playing import LEVELS, play

from smarttac_can.bench import Texture, stimulator_od, track
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.states import VibrationLaw

PASSES = 10


@pytest.mark.parametrize("subject", LEVELS)
@pytest.mark.parametrize(("shape", "one_pass"), [("sine", 0.93), ("square", 0.80)])
def test_a_grating_of_2_mm_at_60_mm_per_s(subject: int, shape: str, one_pass: float) -> None:
    texture = Texture.grating(2.0, *LEVELS[subject], shape=shape)
    stroke = play(texture, subject, passes=PASSES)
    found = track(texture, stroke.position, stroke.cof)
    assert found.passes == PASSES
    assert min(found.correlations) >= one_pass
    assert found.mean_correlation >= 0.95
    assert found.harmonics[0].gain == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(("shape", "one_pass"), [("sine", 0.93), ("square", 0.80)])
def test_texture_under_predictive_vibration_law_bears_dead_time(
    shape: str, one_pass: float
) -> None:
    texture = Texture.grating(2.0, *LEVELS[1], shape=shape)
    law = VibrationLaw.PREDICTIVE
    stroke = play(texture, 1, passes=PASSES, vibration_law=law, dead_time_us=540)
    found = track(texture, stroke.position, stroke.cof)
    assert min(found.correlations) >= one_pass
    assert found.mean_correlation >= 0.95


def test_without_a_preview_it_is_late() -> None:
    texture = Texture.grating(2.0, *LEVELS[2])
    late, ahead = (play(texture, 2, passes=6, preview_us=us) for us in (0, 1500))
    assert np.mean(track(texture, late.position, late.cof).correlations) < 0.88
    assert np.mean(track(texture, ahead.position, ahead.cof).correlations) > 0.93


def test_a_run_is_the_same_to_the_bit() -> None:
    texture = Texture.grating(2.0, *LEVELS[2])
    assert play(texture, 2, passes=2) == play(texture, 2, passes=2)


def test_a_run_that_ends_by_itself_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def weak() -> ObjectDictionary:
        od = stimulator_od()
        od["Limit.Normal force"].value = 500
        return od

    monkeypatch.setattr(texture_playing, "stimulator_od", weak)
    texture = Texture.grating(2.0, *LEVELS[2])
    with pytest.raises(RuntimeError, match=r"^the run has ended: .*normal force"):
        play(texture, 2, passes=1)
