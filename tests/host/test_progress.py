"""A bar for who looks on, and nothing for a log file."""

import sys
from collections.abc import Iterator
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.host import progress as module
from smarttac_can.host.progress import progress_bar


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


class Broken(Terminal):
    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Begin to look on; pytest puts back what a fixture does to sys.stderr."""
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    return stream


class Clock:
    """Seconds that pass by 0.01 each time that somebody looks."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 0.01
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(module, "monotonic", made)
    return made


@pytest.mark.parametrize(("stream", "shown"), [(Terminal(), True), (StringIO(), False)])
def test_progress_is_for_a_terminal(
    stream: StringIO, shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("soaking") as progress:
        progress(0.5)
        progress(1.0)
    said = stream.getvalue()
    assert ("soaking" in said and "100%" in said and said.endswith("\n")) if shown else said == ""


def test_a_process_without_stderr_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    closed = Terminal()
    closed.close()
    for stream in (None, closed, Broken()):
        monkeypatch.setattr(sys, "stderr", stream)
        with progress_bar("soaking") as progress:
            progress(0.5)
            progress(1.0)


def test_an_error_of_the_block_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with pytest.raises(OSError, match="of the run"), progress_bar("soaking"):
        raise OSError("of the run")
    with progress_bar("after") as progress:
        progress(1.0)
    assert "after" in terminal.getvalue()


def test_a_block_has_to_last(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    terminal = on_terminal(monkeypatch)
    with progress_bar("short", after=2.0) as progress:
        progress(0.5)
        progress(1.0)
    assert terminal.getvalue() == ""
    with progress_bar("long", after=2.0) as progress:
        progress(0.25)
        clock.now += 2.0
        progress(0.5)
        progress(0.75)
    said = terminal.getvalue()
    assert "long" in said and "50%" in said
    assert "25%" not in said and "75%" not in said  # not each call is drawn


def test_one_is_shown_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with progress_bar("outer") as outer, progress_bar("inner") as inner:
        inner(0.5)
        outer(1.0)
    assert "inner" not in terminal.getvalue()
    assert "100%" in terminal.getvalue()


def test_a_worker_process_shows_none(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    monkeypatch.setattr(module, "parent_process", object)
    with progress_bar("cells") as progress:
        progress(1.0)
    assert terminal.getvalue() == ""


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """What a notebook was asked to show, and to show in its place."""
    shown: list[tuple[str, str]] = []

    def display(html: str, display_id: bool) -> Any:
        assert display_id
        shown.append(("new", html))
        return SimpleNamespace(update=lambda other: shown.append(("update", other)))

    ipython: Any = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=object()))
    monkeypatch.setitem(sys.modules, "IPython", ipython)
    monkeypatch.setitem(
        sys.modules,
        "IPython.display",
        SimpleNamespace(HTML=str, display=display),  # type: ignore[arg-type]
    )
    return shown


def test_a_bar_in_a_notebook(notebook: list[tuple[str, str]], capfd: Any) -> None:
    with progress_bar("a < b") as progress:
        progress(1.0)
    assert notebook == [
        ("new", 'a &lt; b <progress value="0.000" max="1"></progress> 0%'),
        ("update", 'a &lt; b <progress value="1.000" max="1"></progress> 100%'),
    ]
    assert capfd.readouterr() == ("", "")


@pytest.fixture
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("local") as made:
        yield made


def test_a_long_run_shows_how_far_it_is(
    bench: Stimulator, monkeypatch: pytest.MonkeyPatch, clock: Clock
) -> None:
    terminal = on_terminal(monkeypatch)
    bench.run(0.15, "short")
    assert terminal.getvalue() == ""
    trace = bench.run(0.5, "fig5.long")
    said = terminal.getvalue()
    assert "fig5.long" in said and "100%" in said
    assert len(trace) == 500


def test_a_long_run_in_a_notebook(
    bench: Stimulator, notebook: list[tuple[str, str]], clock: Clock
) -> None:
    bench.run(0.5)
    assert notebook[0][0] == "new"
    assert notebook[-1] == ("update", 'run <progress value="1.000" max="1"></progress> 100%')
    assert 10 < len(notebook) < 60


def test_a_run_that_fails_leaves_the_bar(
    bench: Stimulator, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = on_terminal(monkeypatch)
    block = bench._link._block  # type: ignore[attr-defined]
    tick, left = block.tick, iter(range(400))

    def failing() -> None:
        if next(left, None) is None:
            raise BenchError("it broke")
        tick()

    monkeypatch.setattr(type(block), "tick", lambda _self: failing())
    with pytest.raises(BenchError, match="it broke"):
        bench.run(1.0)
    assert terminal.getvalue().endswith("\n")


def test_nothing_off_a_terminal(bench: Stimulator, clock: Clock, capfd: Any) -> None:
    bench.run(0.5)
    assert capfd.readouterr() == ("", "")
