"""Runs without a failure, on plates that soften and behind pick-ups with a window."""

import pytest

from smarttac_can.assurance.trials.healthy_runs import healthy_run


def test_a_seed_gives_the_same_run() -> None:
    assert healthy_run(3) == healthy_run(3)


@pytest.mark.parametrize(
    "seed",
    [
        # The window sees what the vibration was half a window before it fell.
        90681,
        # 150 Hz/um: at 0 V the vibration turns by 75 degrees a cycle.
        5046,
        # A finger taps, and with a dead time of 999 us the plate overshoots again after each cut.
        100008,
    ],
)
def test_overshoot_that_falls_at_0_v_ends_no_run(seed: int) -> None:
    run = healthy_run(seed)
    assert (run.ended_by, run.false) == ("", False)
