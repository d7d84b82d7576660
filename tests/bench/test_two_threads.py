"""A second thread that lets the loop run is told so, and the first one goes on."""

import inspect
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread
from typing import Any, Literal

import pytest
from nodes_on_a_bus import GUARD_S, in_threads, stimulator_with_plate, until

from smarttac_can.bench import (
    BenchError,
    BusyError,
    Mode,
    Placing,
    RefusedError,
    State,
    Stimulator,
    Texture,
    Trace,
)
from smarttac_can.bench.plate_loads import SimulatedFinger


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


@contextmanager
def a_bench(where: str, virtual: dict[str, Any]) -> Iterator[Stimulator]:
    """Yield a bench of a simulation on a link, or of a stimulator in real time."""
    if where != "real time":
        with Stimulator.simulate("local" if where == "local" else "bus") as bench:
            yield bench
        return
    with (
        in_threads(virtual, stimulator_with_plate(lockstep=False), lockstep=False),
        Stimulator.connect(**virtual) as bench,
    ):
        yield bench


class RunBeside:
    """A run in another thread, whose cycles are counted."""

    def __init__(self, bench: Stimulator, executor: ThreadPoolExecutor) -> None:
        self.cycles, self.over = 0, Event()
        self.future: Future[Trace] = executor.submit(bench.run, 600, meanwhile=self._count)

    def _count(self, cycles: int) -> None:
        self.cycles = cycles
        if self.over.is_set():
            raise InterruptedError

    def goes_on(self) -> None:
        """Wait for further cycles: what was called before came between two of them."""
        now = self.cycles
        until(lambda: self.future.done() or self.cycles > now + 1)
        assert not self.future.done()


@contextmanager
def running_beside(bench: Stimulator) -> Iterator[RunBeside]:
    """Have another thread in `run` during the block, which waits until it has begun."""
    with ThreadPoolExecutor(1) as executor:
        run = RunBeside(bench, executor)
        try:
            run.goes_on()
            yield run
        finally:
            run.over.set()
            with suppress(InterruptedError, BenchError):
                run.future.result(GUARD_S)


def recorded(bench: Stimulator, path: Path) -> None:
    with bench.record(path):
        bench.mark("here")


def heard(bench: Stimulator, seconds: float = 0) -> None:
    with bench.events() as events:
        assert list(events.within(seconds)) == []


def without_recording(bench: Stimulator) -> None:
    with pytest.raises(RefusedError, match="was started without a recording"):
        bench.finger.play_recording()


def weighed(bench: Stimulator) -> None:
    placing = Placing(200, 0, 0, 0)
    bench.finger.put(placing)
    bench.finger.put(placing.empty)


def assigned(name: str, value: Any) -> Callable[[Stimulator, Path], object]:
    return lambda bench, _: setattr(bench, name, value)


WHOLE: dict[str, Callable[[Stimulator, Path], object]] = {
    "amplitude": assigned("amplitude", 1.0),
    "boundary": assigned("boundary", 1.0),
    "claim": lambda bench, _: bench.claim(),
    "cof": assigned("cof", (0.3, 0.4)),
    "disarm": lambda bench, _: bench.disarm(),
    "events": lambda bench, _: heard(bench),
    "finger.play_recording": lambda bench, _: without_recording(bench),
    "finger.stroke": lambda bench, _: bench.finger.stroke(2),
    "finger.lift": lambda bench, _: bench.finger.lift(),
    "finger.put": lambda bench, _: weighed(bench),
    "finger.surroundings": lambda bench, _: bench.finger.surroundings(seed=3, temperature=30),
    "frequency": assigned("frequency", 43_400.0),
    "get": lambda bench, _: bench.get("Limit.Voltage"),
    "law": assigned("law", "measured"),
    "mark": lambda bench, path: recorded(bench, path / "mark.h5"),
    "message": lambda bench, _: bench.message,
    "mode": assigned("mode", "off"),
    "nearest": lambda bench, _: bench.nearest("Limit.Voltage", 80_000),
    "quick_stop": lambda bench, _: bench.quick_stop(),
    "read": lambda bench, _: bench.read(),
    "record": lambda bench, path: recorded(bench, path / "record.h5"),
    "reset_fault": lambda bench, _: bench.reset_fault(),
    "set": lambda bench, _: bench.set("Limit.Voltage", 80_000),
    "set_all": lambda bench, _: bench.set_all({"Limit.Voltage": 80_000}),
    "state": lambda bench, _: bench.state,
    "texture": assigned("texture", Texture.grating(2.0, 0.25, 0.45)),
    "texture_slot": assigned("texture_slot", 2),
    "vibration_law": assigned("vibration_law", "pi"),
    "voltage": assigned("voltage", 20.0),
    "start_run": lambda bench, _: bench.start_run(),
}
"""What may go beside the run of another thread."""
LOOPS: dict[str, Callable[[Stimulator], object]] = {
    "run": lambda bench: bench.run(0.01),
    "sample": lambda bench: bench.sample(["Plate input.S1"], 1),
    "tare": lambda bench: bench.tare(),
    "identify": lambda bench: bench.identify(),
}
"""What lets the loop run itself."""
OTHERS = {"simulate", "connect", "close", "arm"}


def test_every_call_of_a_bench_has_its_rule() -> None:
    public = {name for name in dir(Stimulator) if not name.startswith("_")}
    assert public == {name.partition(".")[0] for name in {*WHOLE, *LOOPS}} | OTHERS
    calls = {name for name, what in vars(SimulatedFinger).items() if inspect.isfunction(what)}
    tried = {name.removeprefix("finger.") for name in WHOLE if name.startswith("finger.")}
    assert {name for name in calls if not name.startswith("_")} == tried | {"recall", "begin"}


@pytest.mark.parametrize("where", ["local", "bus", "real time"])
def test_every_call_is_whole_beside_a_run(
    where: str, virtual: dict[str, Any], tmp_path: Path
) -> None:
    with a_bench(where, virtual) as bench:
        bench.run(0.2)  # tared, so that it is ready
        with running_beside(bench) as run:
            for act in WHOLE.values():
                act(bench, tmp_path)
                run.goes_on()
            if where == "real time":  # else time passes by the cycles of one thread alone
                heard(bench, 0.01)
            bench.arm()
            loops = list(LOOPS.values())
            for loop in loops if where == "real time" else [*loops, lambda b: heard(b, 0.01)]:
                with pytest.raises(BusyError, match="wait for its end"):
                    loop(bench)
                run.goes_on()
                assert (bench.state, bench.mode) == (State.ARMED, Mode.OFF)


@pytest.mark.parametrize("where", ["local", "bus", "real time"])
def test_a_pair_of_cof_is_never_half_written(where: str, virtual: dict[str, Any]) -> None:
    pairs = [(0.1, 0.2), (0.3, 0.4)]
    seen = [pairs[0]]
    with a_bench(where, virtual) as bench, running_beside(bench) as run:
        bench.cof = pairs[0]
        over = Event()

        def write(pair: tuple[float, float]) -> None:
            while not over.is_set():
                bench.cof = pair

        def changed_often() -> bool:
            seen.extend(bench.cof for _ in range(20))
            return sum(one != other for one, other in pairwise(seen)) >= 50

        interval = sys.getswitchinterval()
        sys.setswitchinterval(1e-6)  # else a thread without a bus seldom stops within a pair
        with ThreadPoolExecutor(2) as executor:
            writers = [executor.submit(write, pair) for pair in pairs]
            try:
                until(changed_often)
                run.goes_on()
            finally:
                over.set()
                sys.setswitchinterval(interval)
            for writer in writers:
                writer.result(GUARD_S)
    assert set(seen) == set(pairs)


@pytest.mark.parametrize("where", ["local", "bus", "real time"])
def test_close_ends_the_run_of_another_thread_by_name(where: str, virtual: dict[str, Any]) -> None:
    with a_bench(where, virtual) as bench, running_beside(bench) as run:
        bench.close()
        with pytest.raises(BenchError, match=" was closed during this call") as caught:
            run.future.result(GUARD_S)
        assert caught.value.trace is not None
