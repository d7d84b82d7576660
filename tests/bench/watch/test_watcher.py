"""A listener on a simulated bus shows the values of the node, and sends reads alone."""

from collections.abc import Iterator

import pytest

from smarttac_can.assurance.trials.rig import LocalMaster
from smarttac_can.bench.link import published_pdos
from smarttac_can.bench.simulation import lockstep_nodes, plate_od, stimulator_od
from smarttac_can.bench.watch.extremes import Extremes
from smarttac_can.bench.watch.screen import LEAST_COLUMNS, LEAST_LINES, lines
from smarttac_can.bench.watch.watcher import (
    PUBLISHED,
    READ,
    READ_RARELY,
    PublishedValues,
    View,
    Watcher,
    view_of,
)
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.requests import nmt
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import Mode, State, Status
from smarttac_can.vocabulary.watchdogs import Watchdog

OD = stimulator_od()
SDO_REQUESTS = 0x620
UPLOAD = 0x40


def test_each_fault_of_the_watch_names_the_next_step() -> None:
    latched = {"Diagnosis.Latched": sum(1 << watchdog for watchdog in Watchdog)}
    view = view_of(OD, {}, latched)
    assert len(view.latched) == len(view.remedies) == len(Watchdog)
    assert all(view.remedies)


class Scene:
    """A stimulator with the plate inside, a master, and a watcher, on one clock."""

    def __init__(self, *, reads: bool = True) -> None:
        self.bus = LocalBus()
        self.watcher = Watcher(stimulator_od(), reads=reads)
        self.sent: list[Frame] = []
        self.cut = False  # requests of the watcher are lost
        self._port = self.bus.connect(
            lambda frame: self.watcher.receive(self.bus.time * 1e-6, frame)
        )
        self.master = LocalMaster(self.bus, lambda frame: None)
        self.node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()))
        self.plug = self.bus.attach(self.node, lockstep=False)

    def start(self) -> None:
        self.node.block.write("Drive unwatched", 1)
        self.master.send(nmt(NMTCommand.START, 32))

    def write(self, name: str, raw: int) -> None:
        self.master.write(32, OD[name], raw)

    def drive(self, mode: int) -> None:
        for name, raw in (
            ("Controlword", 0),
            ("Controlword", 1),
            ("Mode", mode),
            ("Controlword", 3),
        ):
            self.write(name, raw)

    def watch(self, seconds: float) -> View:
        for _ in range(round(seconds / 0.01)):
            self.bus.advance(10_000)
            for frame in self.watcher.advance(self.bus.time * 1e-6):
                self.sent.append(frame)
                if not self.cut:
                    self._port.send(frame)
        return self.watcher.view(self.bus.time * 1e-6)

    def value(self, name: str, unit: str) -> float:
        return self.node.od[name].read() * OD[name].unit.in_unit(unit)


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    yield made
    made.bus.shutdown()


@pytest.fixture(scope="module")
def regulated() -> Iterator[tuple[Scene, View]]:
    """Scene in which the friction of a finger is regulated, and its view."""
    scene = Scene()
    scene.start()
    scene.write("Finger.Motion", 1)
    scene.write("Simulation.Start run", 1)
    scene.watch(1.0)
    scene.write("Setpoint.COF left", 2500)
    scene.write("Setpoint.COF right", 2500)
    scene.drive(4)
    yield scene, scene.watch(4.0)
    scene.bus.shutdown()


def test_watcher_shows_the_values_of_the_node(regulated: tuple[Scene, View]) -> None:
    scene, view = regulated
    assert (view.state, view.mode, view.latched, view.notes) == ("running", "friction", (), ())
    assert view.flags == ("live", "driving", "touching")
    assert view.values["Contact.COF reference"] == 0.25
    assert view.values["Contact.COF"] == pytest.approx(0.25, abs=0.05)
    # The TPDOs are up to an event time of 0.1 s old.
    assert view.values["Contact.Normal force"] == pytest.approx(
        scene.value("Contact.Normal force", "N"), abs=0.05
    )
    assert view.values["Vibration.Voltage"] == pytest.approx(
        scene.value("Vibration.Voltage", "V"), rel=0.3
    )
    assert view.values["Vibration.Frequency"] == pytest.approx(
        scene.value("Vibration.Frequency", "Hz"), abs=5
    )
    assert view.values["Contact.Position"] == pytest.approx(
        scene.value("Contact.Position", "mm"), abs=6.0
    )
    assert view.values["Setpoint.COF left"] == 0.25
    assert view.values["Cycle.Lost cycles"] == 0
    assert view.cycle_rate == pytest.approx(1000, abs=30)
    assert view.peers[0].nmt == "operational"
    shown = [cof for cof, _ in view.history if cof is not None]
    assert len(shown) > 5


def test_it_sends_reads_of_single_objects_alone_and_seldom(scene: Scene) -> None:
    scene.start()
    scene.watch(3.0)
    assert {frame.can_id for frame in scene.sent} == {SDO_REQUESTS}
    assert {frame.data[0] for frame in scene.sent} == {UPLOAD}
    assert 40 < len(scene.sent) <= 61


def test_without_sdo_it_sends_nothing_and_shows_the_rest() -> None:
    scene = Scene(reads=False)
    scene.start()
    view = scene.watch(3.0)
    assert scene.sent == []
    assert view.state == "ready"
    assert "Contact.Normal force" in view.values
    assert not view.values.keys() & READ.keys()
    assert not view.values.keys() & {"Contact.COF", "Contact.Position"}  # no finger
    assert view.cycle_rate is None
    scene.bus.shutdown()


def test_another_mapping_is_found_out(scene: Scene) -> None:
    scene.start()
    scene.watch(1.0)
    scene.node.od.entry(0x1A02, 1).value = 0x20300810  # speed where the reference was
    scene.write("Setpoint.Boundary", 100)
    scene.master.send(nmt(NMTCommand.RESET_NODE, 32))
    # A reset puts the mapping back; a master maps anew before it starts the node.
    master, od = scene.master, OD
    master.write(32, od.entry(0x1802, 1), 0x800003A0)
    master.write(32, od.entry(0x1A02, 0), 0)
    master.write(32, od.entry(0x1A02, 1), 0x20300810)
    master.write(32, od.entry(0x1A02, 0), 2)
    master.write(32, od.entry(0x1802, 1), 0x3A0)
    scene.start()
    at_once = scene.watch(0.3)
    assert "TPDO 3 is not as long as its mapping: it is not decoded" in at_once.notes
    later = scene.watch(4.0)
    assert later.notes == ()
    assert "Contact.COF reference" not in later.values  # in no TPDO any more
    assert "Contact.Normal force" in later.values


def test_an_emergency_has_its_text_and_the_fault_stays(scene: Scene) -> None:
    scene.start()
    scene.watch(1.0)
    scene.drive(2)
    scene.watch(0.2)
    scene.write("Fault.Sensor", 3)
    scene.write("Fault.Kind", 1)
    view = scene.watch(2.0)
    assert view.state == "fault"
    (emergency,) = view.emergencies
    assert (emergency.node_id, emergency.code) == (32, 0x5211)
    assert emergency.text == "a sensor is stuck"
    assert 1.5 < emergency.ago < 2.0
    assert view.latched == ("a sensor is stuck",)
    text = "\n".join(line.text for line in lines(view, "virtual:x", 80, 24))
    assert "FAULT: a sensor is stuck; check the sensors, their amplifiers and cables" in text
    assert "EMCY 5211h a sensor is stuck" in text


def test_a_plate_node_is_shown_beside_it() -> None:
    """The loop over the bus, in lockstep: its PDOs show that both are operational."""
    bus = LocalBus()
    watcher = Watcher(stimulator_od(), plate_od())
    bus.connect(lambda frame: watcher.receive(bus.time * 1e-6, frame))
    master = LocalMaster(bus, lambda frame: None)
    for node in lockstep_nodes(plate_inside=False, presets={}):
        bus.attach(node)
    for node_id in (33, 32):
        master.send(nmt(NMTCommand.START, node_id))
    watcher.advance(0.0)
    for _ in range(500):
        master.sync()
    peers = watcher.view(bus.time * 1e-6).peers
    assert [(peer.name, peer.node_id, peer.nmt) for peer in peers] == [
        ("stimulator", 32, "operational"), ("plate", 33, "operational"),
    ]  # fmt: skip
    # SYNC, three measurements and a drive in each of 500 cycles, and the public TPDOs.
    view = watcher.view(bus.time * 1e-6)
    assert view.frame_rate > 2500
    assert view.bus_load > 0.25
    assert view.notes == ()
    bus.shutdown()


def test_a_node_that_nothing_is_heard_of() -> None:
    watcher = Watcher(OD)
    watcher.advance(10.0)
    assert watcher.view(12.9).notes == ()
    watcher.advance(13.0)
    (note,) = watcher.view(14.0).notes
    assert note.startswith("nothing has been heard of node 32 (stimulator) for 4 s: is it running")


def test_a_node_that_falls_silent_and_comes_back(scene: Scene) -> None:
    scene.start()
    scene.watch(1.0)
    scene.plug.close()
    view = scene.watch(4.0)
    assert view.notes == (
        "node 32 (stimulator) has been silent for 4 s: it has stopped or left the bus",
    )
    assert (view.state, view.values.keys() & PUBLISHED.keys()) == ("", set())
    scene.plug = scene.bus.attach(scene.node, lockstep=False)
    assert not any("silent" in note for note in scene.watch(0.5).notes)


def test_a_node_that_is_not_started(scene: Scene) -> None:
    (note,) = scene.watch(2.5).notes
    assert note == (
        "node 32 (stimulator) is pre-operational: it publishes nothing until a master starts it"
    )


WHY = "the plate is loaded with 0.49 N"


def test_watcher_reads_the_message_in_segments(scene: Scene) -> None:
    scene.start()
    assert scene.watch(4.0).message == ""
    scene.node.block.supervisor._message.value = WHY
    assert scene.watch(2.0).message == WHY


def test_watcher_leaves_a_message_to_the_transfer_of_another_client(scene: Scene) -> None:
    """The next segment that it requests would be one of that transfer."""
    scene.start()
    scene.watch(4.0)
    scene.node.block.supervisor._message.value = WHY
    while scene.sent[-1].data[0] & 0x60 != 0x60:
        scene.watch(0.01)
    count = len(scene.sent)
    scene.watcher.receive(scene.bus.time * 1e-6, Frame(SDO_REQUESTS, bytes((0x40, *bytes(7)))))
    scene.watch(0.25)
    assert len(scene.sent) == count
    assert scene.watch(2.0).message == WHY


def test_another_client_is_left_alone(scene: Scene) -> None:
    """A segmented transfer of another client lasts 30 ms a segment, and is not broken."""
    scene.start()
    scene.watch(1.0)
    before = len(scene.sent)
    for _ in range(50):
        scene.master.send(Frame(SDO_REQUESTS, bytes((UPLOAD, 0x08, 0x10, 0, 0, 0, 0, 0))))
        scene.watch(0.03)
    assert len(scene.sent) - before <= 1
    scene.watch(1.0)
    assert len(scene.sent) - before > 10


def test_a_stop_is_written_until_the_node_rests(scene: Scene) -> None:
    scene.start()
    scene.watch(1.0)
    scene.drive(2)
    scene.watch(0.5)
    scene.cut = True
    scene.watcher.stop()
    assert scene.watch(0.5).state == "running"
    assert scene.watcher.stopping
    assert "stop: written again and again" in scene.watcher.view(scene.bus.time * 1e-6).notes[-1]
    scene.cut = False
    view = scene.watch(0.5)
    assert not scene.watcher.stopping
    assert scene.node.od["Mode"].value == 0
    assert view.state == "ready"


def test_a_stop_ends_with_a_node_that_was_reset(scene: Scene) -> None:
    scene.start()
    scene.watch(1.0)
    scene.drive(2)
    scene.cut = True
    scene.watcher.stop()
    scene.watch(0.3)
    assert scene.watcher.stopping
    scene.master.send(nmt(NMTCommand.RESET_NODE, 32))
    scene.watch(0.3)
    assert not scene.watcher.stopping


def test_the_load_is_that_of_the_frames() -> None:
    """100 frames of 8 bytes, 135 bits each at the longest, in 0.5 s at 125 kbit/s."""
    watcher = Watcher(OD, bit_rate=125_000)
    for number in range(100):
        watcher.receive(1.0 + number * 5e-3, Frame(0x700, bytes(8)))
    view = watcher.view(1.5)
    assert view.bus_load == pytest.approx(100 * 135 / 125_000)
    assert view.frame_rate == 100
    assert watcher.view(9.0).bus_load == 0.0


def test_numbers_of_a_newer_node_are_shown_as_numbers() -> None:
    watcher = Watcher(OD)
    watcher.receive(0.0, Frame(0x1A0, bytes((1, 7, 99))))
    view = watcher.view(0.1)
    assert (view.state, view.mode) == ("unknown", "number 99")


LIMITED = Frame(0x1A0, bytes((1 | Status.LIMITED, State.RUNNING, Mode.AMPLITUDE_RESONANCE)))
FREE = Frame(0x1A0, bytes((1, State.RUNNING, Mode.AMPLITUDE_RESONANCE)))


def published(name: str, raw: int) -> Frame:
    """Return the frame of the TPDO of an object, with 0 for the others."""
    for pdo in published_pdos(OD, lambda entry: int(entry.default)):
        if name in pdo.names:
            values = dict.fromkeys(pdo.names, 0) | {name: raw}
            return Frame(pdo.can_id, pdo.layout.pack(*values.values()))
    raise KeyError(name)


class Limits:
    """The limits in the way that a watcher shows, one frame each ms."""

    def __init__(self) -> None:
        self.published = PublishedValues(OD, Extremes(OD, PUBLISHED))
        self.read = {name: OD[name].read() for name in READ_RARELY}
        self.at = 0.0

    def after(self, *frames: Frame) -> dict[str, str]:
        for frame in frames:
            self.at += 1e-3
            assert self.published.take(self.at, frame)
        older = self.published.older_than_limited()
        return dict(view_of(OD, self.published.at(self.at), self.read, older).limited)


def raw(name: str, value: float) -> int:
    return round(value / OD[name].unit.in_unit(PUBLISHED[name]))


def test_a_value_older_than_limited_is_at_no_limit() -> None:
    """The statusword is sent at once, and the amplitude up to 100 ms later."""
    limits = Limits()
    high, low = (published("Vibration.Amplitude", raw("Vibration.Amplitude", w)) for w in (3, 0.96))
    drive = published("Vibration.Voltage", 0)
    said = {"Vibration.Amplitude": "at its limit of 3 um"}
    assert limits.after(high, drive, LIMITED) == {}
    assert limits.after(high) == said
    assert limits.after(FREE) == {}
    assert limits.after(low, drive, LIMITED) == {}
    assert limits.after(high) == said


def test_limited_without_a_value_at_its_limit_names_no_cause() -> None:
    """It waits for the values of both TPDOs."""
    limits = Limits()
    low = published("Vibration.Amplitude", raw("Vibration.Amplitude", 0.96))
    assert limits.after(LIMITED, low) == {}
    assert limits.after(published("Vibration.Voltage", 0)) == {
        "Vibration.Voltage": "output limited"
    }


def test_open_loop_is_cut_only_if_a_bare_plate_would_exceed_it() -> None:
    read = {name: OD[name].read() for name in READ_RARELY}
    seen = {"Statusword": LIMITED.data[0] | State.RUNNING << 8, "Mode display": Mode.OPEN_LOOP}
    said = [
        view_of(OD, seen, read | {"Setpoint.Voltage": volts}).limited["Vibration.Voltage"]
        for volts in (raw("Vibration.Voltage", 150), raw("Vibration.Voltage", 30))
    ]
    assert said == ["cut: a bare plate would exceed 3 um", "output limited"]


def test_a_view_fits_a_terminal_of_80_by_24(regulated: tuple[Scene, View]) -> None:
    _, view = regulated
    laid = lines(view, "socketcan:can0", 80, 24)
    assert len(laid) <= 24
    assert max(len(line.text) for line in laid) <= 80
    text = "\n".join(line.text for line in laid)
    assert "state running      mode friction" in text
    assert f"COF     {view.values['Contact.COF']:.3f} #" in text
    assert laid[6].text.count("O") + laid[7].text.count("O") == 1


def test_watch_on_a_small_terminal_names_the_needed_size() -> None:
    view = Watcher(OD).view(0.0)
    for columns, height, below, needs in (
        (LEAST_COLUMNS - 1, LEAST_LINES, 0, "72 x 20"),
        (LEAST_COLUMNS, LEAST_LINES - 1, 0, "72 x 20"),
        (LEAST_COLUMNS, 22, 3, "72 x 23"),
    ):
        text = " ".join(line.text for line in lines(view, "virtual:x", columns, height, below))
        assert text == (
            f"the terminal has {columns} x {height} characters, watch needs {needs}: make it larger"
        )
    assert lines(view, "virtual:x", 5, 2)
    laid = lines(view, "virtual:x", 72, 23, 3)
    assert "the terminal" not in laid[0].text
    assert len(laid) <= 20


@pytest.mark.parametrize(
    "told",
    [
        {0: 9},
        {0: 255},
        {0: 8} | dict.fromkeys(range(1, 9), 0x20600220),  # 32 bytes
    ],
)
def test_a_mapping_that_fits_no_frame_is_none(told: dict[int, int]) -> None:
    od = stimulator_od()
    values = PublishedValues(od, Extremes(od, PUBLISHED))
    values.remap({od.entry(0x1A01, place): raw for place, raw in told.items()}, 0.0)
    assert values.take(1.0, Frame(0x1A0, bytes((1, 1, 0))))
    assert not values.take(1.0, Frame(0x2A0, bytes(8)))
    assert not values.take(1.0, Frame(0x2A0, bytes(6)))


def test_extremes_hold_each_frame_between_two_looks() -> None:
    """The COF is 0 where there is none, which is no extreme."""
    watcher = Watcher(OD)
    for at, (force, cof) in enumerate(((500, 0), (900, 3000), (200, 2500))):
        values = force.to_bytes(2, "little") + cof.to_bytes(2, "little")
        watcher.receive(at * 1e-3, Frame(0x2A0, bytes(2) + values + bytes(2)))
    watcher.extremes.end_step(1.0)
    assert watcher.extremes.since(1.0) == {}
    found = watcher.extremes.since(0.9)
    assert found["Contact.Normal force"] == pytest.approx((0.2, 0.9))
    assert found["Contact.COF"] == pytest.approx((0.25, 0.3))
