"""A second thread that lets the loop run is told so, and the first one goes on."""

from threading import Thread
from typing import Any, Literal

import pytest

from smarttac_can.bench import BenchError, BusyError, State, Stimulator


def in_another_thread(act: Any) -> BenchError | None:
    """Return the error that an act raised in a thread of its own."""
    raised: list[BenchError] = []

    def work() -> None:
        try:
            act()
        except BenchError as error:
            raised.append(error)

    thread = Thread(target=work)
    thread.start()
    thread.join()
    return raised[0] if raised else None


@pytest.mark.parametrize("second", ["run", "tare"])
@pytest.mark.parametrize("link", ["local", "bus"])
def test_two_threads_in_run(
    link: Literal["local", "bus"], second: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    raised: list[BenchError | None] = []
    tried: list[str] = []
    with Stimulator.simulate(link) as bench:
        bench.voltage = 20.0
        bench.mode = "open_loop"
        acts = {"run": lambda: bench.run(0.05), "tare": bench.tare}
        own = bench._link

        def never_but_try_once() -> bool:
            if not tried:
                tried.append(second)
                raised.append(in_another_thread(acts[second]))
            return False

        run = own.run
        monkeypatch.setattr(
            own, "run", lambda cycles, rows, _=None: run(cycles, rows, never_but_try_once)
        )
        trace = bench.run(0.05)
        assert len(trace.tick) == 50
        assert bench.state is State.RUNNING, "the refusal of the second has disarmed nothing"
        monkeypatch.undo()
        assert len(bench.run(0.05).tick) == 50
    (error,) = raised
    assert isinstance(error, BusyError)
    assert str(error).startswith(
        "the loop of this stimulator runs already, in another thread that is in run(), tare() or "
        "identify(): wait for its end"
    )
