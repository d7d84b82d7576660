"""An instrument stepped by hand: its commander, and how soon it is at 0 V."""

from collections import deque
from collections.abc import Callable, Iterator
from math import hypot
from pathlib import Path
from time import monotonic

import pytest
from nodes_on_a_bus import GUARD_S, until
from open_pages import voltage

from smarttac_can.bench import Stimulator, read_recording
from smarttac_can.bench.link import Row, never
from smarttac_can.bench.panel.instrument import FAULTS, BusInstrument, Lease, SimulatedBench
from smarttac_can.bench.simulation import open_guided_link
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.watcher import Watcher
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

ME, OTHER = object(), object()


class ByHand:
    """A bench whose time is made here, driven by `ME`."""

    def __init__(self, records: Path | None = None) -> None:
        self.bench = SimulatedBench(records)
        self.now = 100.0
        self.bench.lease.take(ME, self.now)
        self.bench.step(self.now)

    def go_on(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self.now += 0.01
            self.bench.step(self.now)

    def line(self, text: str) -> str:
        self.bench.command(ME, text)
        self.go_on(0.02)
        return self.bench.answer

    def value(self, name: str) -> float | None:
        assert self.bench.seen is not None
        return self.bench.seen.view.values.get(name)

    @property
    def state(self) -> str:
        assert self.bench.seen is not None
        return self.bench.seen.view.state


@pytest.fixture
def by_hand() -> ByHand:
    made = ByHand()
    made.go_on(0.3)
    return made


def test_one_drives_until_he_is_not_heard() -> None:
    lease = Lease()
    assert lease.take(ME, 1.0)
    assert not lease.take(OTHER, 1.0)
    lease.renew(OTHER, 5.0)
    assert not lease.expire(1.79)
    lease.renew(ME, 1.5)
    assert not lease.expire(2.29)
    assert lease.held_by(ME)
    lease.renew(ME, 2.31)
    assert lease.expire(2.31), "what waited while all stood still comes too late"
    assert not lease.held_by(ME)
    assert not lease.drop(ME)
    assert lease.take(OTHER, 9.0)
    assert lease.drop(OTHER)


@pytest.mark.parametrize("idle_ms", [0, 1, 3, 9])
def test_a_stop_is_0_v_two_cycles_later_at_most(by_hand: ByHand, idle_ms: int) -> None:
    """However long the bench has slept when the stop comes."""
    by_hand.line("voltage 40")
    by_hand.line("mode open_loop")
    by_hand.go_on(0.1)
    assert voltage(by_hand.bench) == 40.0
    by_hand.now += idle_ms * 1e-3
    by_hand.bench.stop()
    by_hand.now += 2e-3
    by_hand.bench.step(by_hand.now)
    assert voltage(by_hand.bench) == 0.0
    assert by_hand.state == "ready"


def test_stop_ends_a_simulation_batch_within_a_cycle(by_hand: ByHand) -> None:
    """It comes in the third cycle of a batch of 50."""
    by_hand.line("voltage 40")
    by_hand.line("mode open_loop")
    by_hand.go_on(0.1)
    cycles = by_hand.value("Cycle.Cycles")
    run = by_hand.bench._link.run

    def stopped_on_the_way(
        count: int, rows: list[Row], interrupted: Callable[[], bool] = never
    ) -> None:
        def ask() -> bool:
            if len(rows) == 2:
                by_hand.bench.stop()
            return interrupted()

        run(count, rows, ask)
        assert len(rows) == 2

    by_hand.bench._link.run = stopped_on_the_way  # type: ignore[method-assign]
    by_hand.now += 0.05
    by_hand.bench.step(by_hand.now)
    by_hand.bench._link.run = run  # type: ignore[method-assign]
    by_hand.now += 2e-3
    by_hand.bench.step(by_hand.now)
    assert voltage(by_hand.bench) == 0.0
    now = by_hand.value("Cycle.Cycles")
    assert cycles is not None
    assert now is not None
    assert now - cycles == 4


def test_stop_drops_queued_commands(by_hand: ByHand) -> None:
    by_hand.bench.command(ME, "mode open_loop")
    by_hand.bench.stop()
    by_hand.go_on(0.1)
    assert by_hand.state == "ready"
    assert by_hand.bench.answer == "stop"


def test_a_line_between_a_stop_and_0_v_is_refused(by_hand: ByHand) -> None:
    by_hand.bench.stop()
    by_hand.bench.command(ME, "mode open_loop")
    assert by_hand.bench.answer == "mode open_loop: not done, wait for what is being done"


def test_the_end_of_an_instrument_is_0_v() -> None:
    """Of a page that goes on driving."""
    with SimulatedBench() as bench:
        bench.lease.take(ME, monotonic() + GUARD_S)
        for text in ("voltage 40", "mode open_loop"):
            bench.command(ME, text)
        until(lambda: bench.seen and voltage(bench) == 40.0)
    assert voltage(bench) == 0.0
    assert bench.answer == "the panel has ended: stopped"


def test_panel_takes_commands_and_guides_of_the_driver_alone(by_hand: ByHand) -> None:
    by_hand.bench.command(OTHER, "mode open_loop")
    by_hand.bench.guide(OTHER, 5.0, 1.0)
    by_hand.go_on(0.2)
    assert by_hand.state == "ready"
    assert by_hand.bench.answer == "mode open_loop: not done, this page does not drive"
    assert by_hand.value("Contact.Normal force") == pytest.approx(0.0, abs=0.02)


def test_panel_drops_queued_commands_of_a_page_that_has_left(by_hand: ByHand) -> None:
    by_hand.bench.command(ME, "mode open_loop")
    by_hand.bench.lease.drop(ME)
    by_hand.go_on(0.1)
    assert by_hand.state == "ready"


def test_lines_are_obeyed_in_their_order_and_few_wait(by_hand: ByHand) -> None:
    for text in ("voltage 40", "voltage 30", "mode open_loop", "voltage 20", "voltage 10"):
        by_hand.bench.command(ME, text)
    assert by_hand.bench.answer == "voltage 10: not done, wait for what is being done"
    by_hand.go_on(0.1)
    assert by_hand.bench.answer == "done: voltage 20 V"
    assert voltage(by_hand.bench) == 20.0


def test_panel_finger_follows_its_driver_and_lifts_without_it(by_hand: ByHand) -> None:
    by_hand.line("cof 0.3 0.2")
    by_hand.line("mode friction")
    for step in range(200):
        by_hand.bench.guide(ME, -10.0 + 0.05 * step, 0.5)
        by_hand.go_on(0.01)
    assert by_hand.value("Contact.Normal force") == pytest.approx(0.5, abs=0.03)
    assert by_hand.value("Contact.Position") == pytest.approx(0.0, abs=1.0)
    assert by_hand.value("Contact.COF") == pytest.approx(0.3, abs=0.06)
    with pytest.raises(ValueError, match=r"x 0\.05 is outside"):
        by_hand.bench.guide(ME, 50.0, 0.5)
    by_hand.bench.leave(ME)
    by_hand.go_on(0.2)
    assert by_hand.value("Contact.Normal force") == pytest.approx(0.0, abs=0.02)
    assert by_hand.bench.answer == "the page that drove has left: stopped"


def test_a_stroke_and_the_hand_begin_new_runs_at_0_v(by_hand: ByHand) -> None:
    by_hand.line("voltage 40")
    by_hand.line("mode open_loop")
    assert by_hand.line("stroke 2 0.6 80") == "done: the finger strokes by itself"
    assert by_hand.state != "running"
    by_hand.go_on(1.0)
    assert by_hand.value("Contact.Normal force") == pytest.approx(0.6, abs=0.03)
    assert by_hand.line("hand") == "done: the mouse is the finger"
    by_hand.go_on(0.3)
    assert by_hand.value("Contact.Normal force") == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("fault", FAULTS)
def test_panel_failure_is_0_v_with_its_reason(by_hand: ByHand, fault: str) -> None:
    by_hand.bench.guide(ME, 0.0, 0.5)
    by_hand.line("amplitude 1")
    by_hand.line("mode amplitude_resonance")
    by_hand.go_on(0.3)
    assert by_hand.state == "running"
    assert by_hand.line(f"break {fault}") == f"done: break {fault}"
    by_hand.go_on(0.5)
    assert by_hand.state == "fault"
    assert voltage(by_hand.bench) == 0.0
    assert by_hand.bench.seen is not None
    assert all(by_hand.bench.seen.view.remedies)
    assert len(by_hand.bench.seen.view.remedies) == len(by_hand.bench.seen.view.latched) > 0
    by_hand.line("mend")
    for _ in range(30):  # 3 s at most
        by_hand.go_on(0.1)
        if by_hand.line("reset") == "done: fault reset":
            break
    assert by_hand.state == "ready"


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("break glass", "'glass' is none of: a gauge is stuck"),
        ("stroke x 1 1", "invalid literal"),
        ("stroke 1 nan 50", "nan"),
        ("stroke 99 1 50", "99"),
        ("slot 99999999999999999999", "value written too high"),
        ("cof \ud800", "is no number"),
        ("", "'' is none of"),
    ],
)
def test_nonsense_is_answered(by_hand: ByHand, text: str, answer: str) -> None:
    said = by_hand.line(text)
    assert answer in said
    assert not said.startswith("done")
    assert by_hand.state == "ready"


def test_laws_and_textures_are_chosen(by_hand: ByHand) -> None:
    assert by_hand.line("law predictive") == "done: friction law predictive"
    assert by_hand.line("vibration predictive") == "done: vibration law predictive"
    assert by_hand.line("slot 2") == "done: texture 2"
    assert by_hand.value("Friction law") == Law.PREDICTIVE
    assert by_hand.value("Controller.Vibration law") == VibrationLaw.PREDICTIVE
    assert by_hand.value("Texture.Slot") == 2
    assert by_hand.line("mode texture") == "done: mode texture"
    assert by_hand.state == "running"


@pytest.mark.parametrize(
    ("text", "answer"),
    [
        ("record stop", "nothing is being recorded"),
        ("record mark x", "nothing is being recorded"),
        ("load 2", "no texture was made for slot 2"),
        ("load x", "invalid literal"),
    ],
)
def test_panel_answers_what_it_cannot_do_yet(tmp_path: Path, text: str, answer: str) -> None:
    assert answer in ByHand(tmp_path).line(text)


def test_panel_records_one_file_at_a_time_and_makes_it_at_its_end(tmp_path: Path) -> None:
    by_hand = ByHand(tmp_path)
    assert by_hand.line("record start dry").startswith("done: recording into panel-")
    assert "one file at a time" in by_hand.line("record start")
    assert by_hand.line("record mark") == "marker '' is no text of 1 to 1000 characters"
    assert "is none of start, mark, stop" in by_hand.line("record pause")
    by_hand.go_on(0.2)
    assert by_hand.bench.recorder is not None
    by_hand.bench.recorder.end()
    (path,) = tmp_path.iterdir()
    assert len(read_recording(path).channels["cof"]) >= 200
    assert by_hand.bench.recorder.made().startswith(f"done: {path.name} has ")


def test_panel_without_a_folder_records_nothing(by_hand: ByHand) -> None:
    assert by_hand.line("record start") == "this panel was started without --record FOLDER"


def test_a_stop_ends_an_identification(by_hand: ByHand) -> None:
    by_hand.line("identify")
    assert by_hand.state == "running"
    by_hand.bench.stop()
    by_hand.go_on(0.1)
    assert by_hand.state == "ready"
    assert by_hand.bench.answer == "stop"


def test_panel_names_the_limit_that_is_in_the_way(by_hand: ByHand) -> None:
    by_hand.line("voltage 150")
    by_hand.line("mode open_loop")
    by_hand.go_on(0.1)
    assert by_hand.bench.seen is not None
    assert by_hand.bench.seen.view.limited == {
        "Vibration.Voltage": "cut: a bare plate would exceed 3 um"
    }
    assert voltage(by_hand.bench) == pytest.approx(60.0)


def test_extremes_of_a_page_are_those_since_its_last_update(by_hand: ByHand) -> None:
    by_hand.line("voltage 40")
    by_hand.line("mode open_loop")
    since = by_hand.now
    by_hand.bench.stop()
    by_hand.go_on(0.1)
    assert by_hand.bench.extremes.since(since)["Vibration.Voltage"] == (0.0, 0.0)
    assert by_hand.bench.extremes.since(since - 0.03)["Vibration.Voltage"] == (0.0, 40.0)


def test_emergencies_of_a_simulated_bench_are_those_of_a_node(by_hand: ByHand) -> None:
    by_hand.line("mode friction")
    by_hand.line("break a gauge is stuck")
    by_hand.go_on(0.5)
    by_hand.line("mend")
    by_hand.go_on(0.3)
    assert by_hand.line("reset") == "done: fault reset"
    assert by_hand.bench.seen is not None
    newest, *_, oldest = by_hand.bench.seen.view.emergencies
    assert (oldest.node_id, oldest.text) == (32, "a sensor is stuck")
    assert (newest.code, newest.text) == (0, "error reset or no error")


def test_the_vibration_is_shown_in_its_plane(by_hand: ByHand) -> None:
    by_hand.line("amplitude 1")
    by_hand.line("mode amplitude_resonance")
    by_hand.go_on(0.3)
    d, q = by_hand.value("Vibration.W_d"), by_hand.value("Vibration.W_q")
    assert d is not None
    assert q is not None
    assert hypot(d, q) == pytest.approx(by_hand.value("Vibration.Amplitude"), abs=2e-4)


def test_a_machine_that_slept_does_not_make_up_for_it(by_hand: ByHand) -> None:
    before = by_hand.value("Cycle.Cycles")
    assert before is not None
    by_hand.now += 3600.0
    by_hand.bench.step(by_hand.now)
    by_hand.go_on(0.1)
    after = by_hand.value("Cycle.Cycles")
    assert after is not None
    assert after - before == 200


# On a bus.


class QuietBus:
    """A bus that says nothing."""

    def send(self, frame: Frame) -> None:
        pass

    def wait(self, timeout: float) -> bool:
        return False

    def read(self, frames: deque[Frame]) -> bool:
        return False

    def block(self, can_ids: frozenset[int]) -> None:
        pass

    def close(self) -> None:
        pass


class OnABus:
    """An instrument that `ME` drives, and its view of the bus."""

    def __init__(self, records: Path | None = None) -> None:
        self.link, od, _ = open_guided_link()
        self.stimulator = Stimulator(self.link, od)
        self.watcher = Watcher(od)
        self.instrument = BusInstrument(
            "a bus", od, self.watcher, Listener(QuietBus), self.stimulator, records
        )
        self.instrument.lease.take(ME, 0.0)

    def line(self, text: str) -> str:
        """Return the answer to a line, which a thread of the instrument finds."""
        self.instrument.answer = ""
        self.instrument.command(ME, text)

        def answer() -> str:
            self.instrument.step(1.0)
            return self.instrument.answer

        until(answer)
        return self.instrument.answer


@pytest.fixture
def on_a_bus(tmp_path: Path) -> Iterator[OnABus]:
    made = OnABus(tmp_path)
    yield made
    made.instrument._operator.end()


def test_a_line_that_waits_is_refused_once_the_drive_is_lost(on_a_bus: OnABus) -> None:
    instrument = on_a_bus.instrument
    instrument.command(ME, "mode open_loop")
    instrument.lease.drop(ME)

    def answer() -> str:
        instrument.step(1.0)
        return instrument.answer

    until(answer)
    assert instrument.answer == "mode open_loop: not done, its page does not drive"
    assert on_a_bus.stimulator.mode is Mode.OFF


def test_a_stop_holds_lines_until_the_node_is_disarmed(on_a_bus: OnABus) -> None:
    instrument = on_a_bus.instrument

    def holds(now: float) -> bool:
        instrument.step(now)
        instrument.answer = ""
        instrument.command(ME, "mode open_loop")
        assert instrument.seen is not None
        assert instrument.seen.stopping == bool(instrument.answer)
        return instrument.seen.stopping

    on_a_bus.watcher.receive(0.9, Frame(0x1A0, bytes((2, 1, 1))))
    instrument.stop()
    assert holds(1.0)
    assert holds(2.0)
    on_a_bus.watcher.receive(2.5, Frame(0x1A0, bytes((0, 1, 0))))
    assert not holds(3.0)


def test_panel_on_a_bus_records_with_a_marker(on_a_bus: OnABus, tmp_path: Path) -> None:
    recorder = on_a_bus.instrument.recorder
    assert recorder is not None
    assert on_a_bus.line("record start dry").startswith("done: recording into panel-")
    on_a_bus.link.run(50, [])
    assert on_a_bus.line("record mark here") == "done: marker 'here'"
    on_a_bus.link.run(50, [])
    assert on_a_bus.line("record stop").endswith(" is being made")
    recorder.end()
    (path,) = tmp_path.iterdir()
    assert recorder.made() == f"done: {path.name} has 100 cycles of 1 ms, and 0 are lost"
    assert recorder.shown()["file"] == ""
    recording = read_recording(path)
    assert recording.metadata["notes"] == "dry"
    assert [marker.text for marker in recording.markers] == ["here"]
