"""Cycles with a voltage by mode and by law, where the law acts."""

from smarttac_can.trials.driven_time import DrivenTime
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Mode


def test_seconds_go_to_the_laws_that_act() -> None:
    rig = Rig()
    driven = DrivenTime(rig)
    for mode, law, vibration_law, cycles in (
        (Mode.OPEN_LOOP, 3, 2, 100),
        (Mode.AMPLITUDE, 3, 1, 20),
        (Mode.FRICTION, 3, 2, 3),
        (Mode.TEXTURE, 3, 2, 4),
    ):
        rig.write("Friction law", law)
        rig.write("Controller.Vibration law", vibration_law)
        for _ in range(cycles):
            driven.count(mode)
    assert driven.by_mode() == {
        "open_loop": 0.1,
        "amplitude": 0.02,
        "amplitude_resonance": 0.0,
        "friction": 0.003,
        "identify": 0.0,
        "texture": 0.004,
    }
    assert driven.by_friction_law() == {
        "measured": 0.0,
        "accumulate": 0.0,
        "nominal": 0.0,
        "predictive": 0.003,
    }
    assert driven.by_vibration_law() == {"pi": 0.0, "scheduled": 0.02, "predictive": 0.007}
