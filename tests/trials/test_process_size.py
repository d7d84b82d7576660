"""A process that grows is complained of, but not for its first two minutes."""

from pathlib import Path

from smarttac_can.trials.process_size import ProcessSize

STATM = Path("/proc/self/statm")


def complaint(*mib: float) -> str | None:
    size = ProcessSize()
    size.mib = list(mib)
    return size.complaint()


def test_growth_after_two_minutes_is_seen() -> None:
    assert complaint() is None
    assert complaint(10.0, 40.0) is None
    assert complaint(10.0, 40.0, 50.0, 58.0) is None
    assert complaint(10.0, 40.0, 50.0, 58.1, 50.0) == "the process grew from 50.0 to 58.1 MiB"


def test_sample_is_the_size_of_this_process() -> None:
    size = ProcessSize()
    size.sample()
    assert len(size.mib) == STATM.exists(), "none where the system does not say"
    assert all(10.0 < mib < 4000.0 for mib in size.mib)
