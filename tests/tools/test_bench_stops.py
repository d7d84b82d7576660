"""``tools/bench/measure stops`` finds a broken bound, and measures one."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="priorities of Linux")


@pytest.fixture
def tool(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("bench/stops.py")


@pytest.fixture
def rows(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Rows of a case that always ends like this, on a machine that stood still for so long."""

    def row(act: Any, *, bound_ms: int | None = 20, earliest_ms: int = 0, stood_s: float = 0.0):
        machine = SimpleNamespace(longest_s=[0.0], forget=lambda: None)

        @contextmanager
        def scene(*_: object) -> Iterator[SimpleNamespace]:
            watch = SimpleNamespace(emergencies=[(33, 0x8250)])
            yield SimpleNamespace(watch=watch, notes={}, deadline_ms=20, reason=lambda: "why")

        def acted(here: SimpleNamespace) -> Any:
            here.watch.emergencies.append((33, 0x8253))
            machine.longest_s = [stood_s]
            return act()

        monkeypatch.setattr(tool, "scene", scene)
        case = tool.Case("case", bound_ms, acted, earliest_ms)
        return tool.measured(case, None, 2, set(), machine)

    return row


@pytest.mark.parametrize(
    ("after_ms", "before_ms", "stood_ms", "ok"),
    [(15, 16, 0, True), (19, 25, 0, True), (21, 22, 0, False), (21, 22, 5, True)],
    ids=["in time", "perhaps", "late", "the machine was"],
)
@pytest.mark.parametrize("bound_ms", [20, None])
def test_a_bound_is_broken_by_a_voltage_that_was_there_after_it(
    after_ms: int,
    before_ms: int,
    stood_ms: int,
    ok: bool,
    bound_ms: int | None,
    tool: Any,
    rows: Any,
) -> None:
    row = rows(
        lambda: tool.Stop(after_ms * 1e-3, before_ms * 1e-3),
        bound_ms=bound_ms,
        stood_s=stood_ms * 1e-3,
    )
    assert row["ok"] is ok
    assert row["bound_ms"] == 20
    assert row["at_0_v_after_ms"] == [before_ms, before_ms]
    assert row["uncertainty_ms"] == before_ms - after_ms
    assert row["measured"] == 2
    assert row["late"] == (0 if ok else 2)
    assert row["emergencies"] == ["33: 8253h"]


def test_bench_stops_omits_runs_ended_by_another_watch(tool: Any, rows: Any) -> None:
    row = rows(lambda: tool.Stop(0.01, 0.011), earliest_ms=12)
    assert row["ok"] is None
    assert row["measured"] == 0
    assert set(row["tripped_before"]) == {"why"}


def test_bench_stops_omits_runs_on_a_machine_at_a_standstill(tool: Any, rows: Any) -> None:
    row = rows(lambda: tool.Stop(0.01, 0.011), stood_s=0.03)
    assert row["ok"] is None
    assert set(row["tripped_before"]) == {"the machine stood still for 30 ms"}


def test_a_voltage_that_comes_back_is_a_broken_bound(tool: Any, rows: Any) -> None:
    def act() -> None:
        raise tool.BoundError("a voltage after 0 V")

    row = rows(act)
    assert row["ok"] is False
    assert row["broken"] == ["a voltage after 0 V"] * 2


@pytest.mark.parametrize("arguments", [("--repeats", "0"), ("--repeats", "many")])
def test_wrong_arguments(arguments: tuple[str, ...], tool: Any, call: Callable[..., int]) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        call(tool, *arguments)


@pytest.mark.long
def test_one_case_with_real_processes(tool: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (case,) = [case for case in tool.CASES if case.name == "stimulator, SIGTERM"]
    monkeypatch.setattr(tool, "CASES", [case])
    (row,) = tool.run(None, 1)["cases"]
    assert row["broken"] == []
    # A machine that is too busy for the loop has to say so.
    assert row["measured"] or row["tripped_before"]
