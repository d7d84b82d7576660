"""Arguments that make no sense are refused in one line that says so."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from smarttac_can.bench import (
    BenchError,
    Stimulator,
    Texture,
    Trace,
    make_recording,
    read_plan,
    stimulator_od,
    write_csv,
)

TRACE = Trace.from_rows("a", 0, [(k, *range(9)) for k in range(3)])


@pytest.mark.parametrize(
    ("act", "text"),
    [
        (lambda bench: bench.run(1e308), r"^seconds 1e\+308 is outside 0\.001\.\.604800$"),
        (lambda bench: bench.run(-1e308), r"^seconds -1e\+308 is outside "),
        (lambda bench: bench.get("Setpoint.Voltage", 5), "^5 is not a unit like mV$"),
        (lambda bench: setattr(bench, "texture_slot", 10**400), "^Texture.Slot 10+ is not a fin"),
    ],
)
@pytest.mark.parametrize("link", ["local", "bus"])
def test_of_a_bench(link: Any, act: Callable[[Stimulator], object], text: str) -> None:
    with Stimulator.simulate(link) as bench, pytest.raises(ValueError, match=text):
        act(bench)


@pytest.mark.parametrize(
    ("act", "text"),
    [
        (lambda: stimulator_od("32"), r"^node_id '32' is no integer of 1\.\.127$"),
        (
            lambda: Stimulator.connect(interface="virtual", node_id=None),
            r"^node_id None is no integer of 1\.\.127$",
        ),
        (lambda: Stimulator.connect(interface=1), "^interface 1 is no name$"),
        (lambda: Texture.profile(None), "^shape None is neither a name nor points"),
        (
            lambda: Texture.profile("ramp", 0.2, 0.4, repeats="no"),
            "^repeats 'no' is neither True nor False$",
        ),
    ],
)
def test_of_what_makes_one(act: Callable[[], object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        act()


@pytest.mark.parametrize("traces", ["run.csv", [TRACE, None], [TRACE.counts]])
def test_what_is_no_trace_replaces_no_file(traces: Any, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_csv(path, TRACE)
    before = path.read_bytes()
    with pytest.raises(ValueError, match=r" is no Trace: write_csv\(path, traces\)$"):
        write_csv(path, traces)
    assert path.read_bytes() == before


def test_counts_that_no_trace_holds() -> None:
    """They would become negative."""
    for number in (2**63, 2**64, 10**30):
        with pytest.raises(ValueError, match=r"^the rows of a are no table of"):
            Trace.from_rows("a", 0, [[number] * 10])


def test_a_recording_without_a_name() -> None:
    with (
        Stimulator.simulate("local") as bench,
        pytest.raises(BenchError, match=r"whose suffix is \.h5 or \.hdf5: name it run\.h5$"),
        bench.record(""),
    ):
        pass


def test_paths_may_be_texts(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="there is no such file"):
        make_recording(str(tmp_path / "x.log"), str(tmp_path / "x.h5"))
    with pytest.raises(OSError, match="there is no such file"):
        read_plan(str(tmp_path / "x.csv"))
