"""Runs without a failure, on plates that soften and behind pick-ups with a window."""

import pytest

from smarttac_can.trials.healthy_runs import healthy_run


def test_a_seed_gives_the_same_run() -> None:
    assert healthy_run(3) == healthy_run(3)


@pytest.mark.parametrize(
    ("seed", "ended_by", "cause"),
    [
        # The window sees what the vibration was half a window before it fell.
        (90681, "AMPLITUDE", "vibration above its limit"),
        # 150 Hz/um: at 0 V the vibration turns by 75 degrees a cycle.
        (5046, "", ""),
    ],
)
def test_a_trip_has_its_cause_in_what_the_pickup_sees(seed: int, ended_by: str, cause: str) -> None:
    run = healthy_run(seed)
    assert (run.ended_by, run.cause, run.false) == (ended_by, cause, False)
