"""A replay gives the recorded frames, to the bit, and names the first difference.

The logs are of a stimulator with a plate node, from when both are switched on.
"""

import functools
import random
from collections.abc import Callable, Iterable

import pytest
from nodes_on_a_bus import regulate_friction

from smarttac_can.assurance.trials.rig import LocalMaster
from smarttac_can.bench import Stimulator, Texture
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.instrument.replay import Difference, DifferenceError, Replay, Replayed
from smarttac_can.vocabulary.meanings import START_RUN
from smarttac_can.vocabulary.states import Control, Mode

Log = list[tuple[int, Frame]]
SYNC, DRIVE, BOOT_UP = 0x080, 0x221, 0x720
SDO_TO, SDO_FROM = 0x620, 0x5A0
DEADLINE_MS = 3
READ = Frame(SDO_TO, bytes.fromhex("4000200000000000"))
"""Of the Statusword."""
LIVE = Frame(SDO_FROM, bytes.fromhex("4B00200001000000"))
"""Its answer, after the first cycle."""


@functools.cache
def _friction_run() -> tuple[tuple[int, Frame], ...]:
    log: Log = []
    with Stimulator.simulate(log=lambda *frame: log.append(frame)) as bench:
        bench.finger.stroke(2, speed=200.0, force_variation=0.2, speed_variation=0.2)
        bench.start_run()
        bench.tare()
        regulate_friction(bench)
        bench.set("Limit.Voltage", "60 V")
        bench.run(0.05)
    return tuple(log)


def friction_run() -> Log:
    """Half a second in lockstep, with set-points that change and reads that are long."""
    return list(_friction_run())


@functools.cache
def _clocked_run(reset: bool) -> tuple[tuple[int, Frame], ...]:
    log, bus, master, node = clocked_bus()
    _drive(bus.advance, master, node)
    _disarm(master, node)
    if reset:
        master.send(requests.nmt(NMTCommand.RESET_NODE))
        _drive(bus.advance, master, node)
        _disarm(master, node)
    return tuple(log)


def clocked_run(*, reset: bool = False) -> Log:
    """Half a second by the clock with SYNC of the stimulator, and again after a reset of both."""
    return list(_clocked_run(reset))


def _drive(advance: Callable[[int], None], master: LocalMaster, node: StimulatorNode) -> None:
    def write(name: str, raw: int) -> None:
        master.write(STIMULATOR_ID, node.od[name], raw)

    write("Drive unwatched", 1)
    for node_id in (PLATE_ID, STIMULATOR_ID):
        master.send(requests.nmt(NMTCommand.START, node_id))
    advance(3000)
    for name, raw in (
        ("Simulation.Subject", 2),
        ("Finger.Force", 500),
        ("Finger.Motion", 1),
        (START_RUN, 1),
    ):
        master.write(PLATE_ID, plate_od()[name], raw)
    write(START_RUN, 1)
    advance(100_000)
    for name, raw in (
        ("Setpoint.COF left", 2500),
        ("Setpoint.COF right", 2500),
        ("Controlword", Control.FAULT_RESET),
        ("Controlword", 0),
        ("Controlword", Control.ARM),
        ("Mode", Mode.FRICTION),
        ("Controlword", Control.ARM | Control.RUN),
    ):
        write(name, raw)
    advance(400_000)


def _disarm(master: LocalMaster, node: StimulatorNode) -> None:
    master.write(STIMULATOR_ID, node.od["Controlword"], 0)


def clocked_node(deadline_ms: int = DEADLINE_MS) -> StimulatorNode:
    return StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True, deadline_ms=deadline_ms
    )


def lockstep_node() -> StimulatorNode:
    return StimulatorNode(
        stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=DEADLINE_MS
    )


def replayed(
    log: Iterable[tuple[int, Frame]],
    *,
    lockstep: bool = True,
    node: Callable[[], StimulatorNode] | None = None,
) -> Replayed:
    power_on = node or (lockstep_node if lockstep else clocked_node)
    replay = Replay(power_on, STIMULATOR_ID, lockstep=lockstep)
    for time, frame in log:
        replay.take(time, frame)
    return replay.end()


def places(log: Log, can_id: int) -> list[int]:
    """Places of the frames with an identifier."""
    return [place for place, (_, frame) in enumerate(log) if frame.can_id == can_id]


def changed(log: Log, place: int, byte: int, value: int) -> Log:
    """Return a log in which a byte of one frame is another."""
    time, frame = log[place]
    data = bytearray(frame.data)
    assert data[byte] != value
    data[byte] = value
    return [*log[:place], (time, Frame(frame.can_id, bytes(data))), *log[place + 1 :]]


def first_difference(
    log: Log, *, lockstep: bool = True, node: Callable[[], StimulatorNode] | None = None
) -> Difference:
    with pytest.raises(DifferenceError) as caught:
        replayed(log, lockstep=lockstep, node=node)
    return caught.value.difference


def test_a_run_in_lockstep_is_the_same_to_the_bit() -> None:
    log = friction_run()
    found = replayed(log)
    drives = [log[place][1].data[:6] for place in places(log, DRIVE)]
    # The last one is of the shutdown.
    assert found.drives == len(drives) > 500
    assert found.unjudged == ()
    assert len(set(drives)) > 100
    own = [f for _, f in log if f.can_id in (0x1A0, 0x2A0, 0x3A0, 0x4A0, SDO_FROM, BOOT_UP, DRIVE)]
    assert found.compared == len(own)
    assert (found.frames, found.power_ons) == (len(log), 1)


@pytest.mark.parametrize("lockstep", [True, False])
def test_replay_takes_the_configured_sync_identifier(lockstep: bool) -> None:
    def power_on() -> StimulatorNode:
        node = lockstep_node() if lockstep else clocked_node()
        sync = node.od.entry(0x1005, 0)
        sync.default = sync.value = sync.value + 1
        return node

    replay = Replay(power_on, STIMULATOR_ID, lockstep=lockstep)
    for time, frame in friction_run() if lockstep else clocked_run():
        replay.take(time, frame._replace(can_id=0x081) if frame.can_id == SYNC else frame)
    assert replay.end().drives > 300


@pytest.mark.parametrize(
    ("byte", "name", "shown"),
    [
        (0, "Drive.Voltage", lambda data: f"{int.from_bytes(data[:2], 'little') * 10} mV"),
        (7, "Drive.Check", lambda data: f"{data[7]}"),
    ],
)
def test_one_byte_of_a_drive_is_named(byte: int, name: str, shown: Callable[[bytes], str]) -> None:
    log = friction_run()
    place = places(log, DRIVE)[300]
    value = log[place][1].data[byte] ^ 0x04
    found = first_difference(changed(log, place, byte, value))
    assert (found.number, found.can_id, found.what) == (place + 1, DRIVE, "drive, TPDO 5")
    assert found.time_s == pytest.approx((log[place][0] - log[0][0]) * 1e-6)
    [field] = found.fields
    assert (field.name, field.recomputed) == (name, shown(log[place][1].data))
    assert field.recorded != field.recomputed
    assert found.recomputed == log[place][1]
    assert f"{name} is {field.recorded} in the log, {field.recomputed} recomputed" in str(found)


def texture_run(texture: Texture) -> Log:
    log: Log = []
    with Stimulator.simulate(log=lambda *frame: log.append(frame)) as bench:
        bench.finger.stroke(2, speed=200.0)
        bench.start_run()
        bench.tare()
        bench.amplitude = 1.0
        bench.texture_slot = 3
        bench.texture = texture
        bench.mode = "texture"
        bench.run(0.25)
        bench.texture = Texture.profile("ramp", 0.2, 0.4, 0.05)
        bench.run(0.05)
    return log


def test_textures_are_taken_from_the_log() -> None:
    """They pass by block transfer, with the answers of the node; the drives follow them."""
    log = texture_run(Texture.grating(2.0, 0.25, 0.45))
    found = replayed(log)
    assert found.drives == len(places(log, DRIVE)) > 300
    # The segments of another texture, with its own checksums, in the place of these.
    other = iter(texture_run(Texture.grating(2.0, 0.25, 0.55)))
    sdo = iter([frame for _, frame in other if frame.can_id == SDO_TO])
    mixed = [(t, next(sdo) if frame.can_id == SDO_TO else frame) for t, frame in log]
    difference = first_difference(mixed)
    assert difference.can_id in (DRIVE, 0x3A0)


def test_another_set_point_shows_in_the_drives() -> None:
    log = friction_run()
    writes = [
        place
        for place in places(log, SDO_TO)
        if log[place][1].data[0] in (0x2B, 0x23) and log[place][1].data[4:6] == b"\xd0\x07"
    ]  # 2000, COF 0.2 on the left
    found = first_difference(changed(log, writes[0], 4, 0xD1))
    assert found.number > writes[0]
    assert found.what in ("drive, TPDO 5", "TPDO 3")


def test_a_byte_that_the_plate_measured_shows_at_once() -> None:
    log = friction_run()
    place = places(log, 0x3A1)[300]
    found = first_difference(changed(log, place, 0, log[place][1].data[0] ^ 0x10))
    # Its check does not hold, so it is answered by nothing.
    assert (found.what, found.recomputed) == ("drive, TPDO 5", None)
    assert found.number == places(log, DRIVE)[300] + 1
    assert "nothing that the log has makes the node send this drive" in str(found)


def test_a_drive_that_is_not_there_is_missed() -> None:
    log = friction_run()
    place = places(log, DRIVE)[-20]
    found = first_difference(log[:place] + log[place + 1 :])
    # The next one is compared with it.
    assert (found.what, found.fields[0].name) == ("drive, TPDO 5", "Drive.Tick")


def test_a_drive_of_another_tick_answers_nothing() -> None:
    log = friction_run()
    place = places(log, DRIVE)[300]
    found = first_difference(changed(log, place, 6, log[place][1].data[6] ^ 0x04))
    assert (found.number, found.recomputed) == (place + 1, None)


def test_replay_ignores_unsent_frames_at_the_end_of_a_log() -> None:
    log = friction_run()
    assert replayed(log[: places(log, DRIVE)[300]]).drives == 300


def test_a_log_that_lacks_all_drives_from_some_time_on_is_told() -> None:
    log = friction_run()
    place = places(log, DRIVE)[300]
    rest = [item for item in log[place:] if item[1].can_id != DRIVE]
    found = first_difference(log[:place] + rest)
    assert (found.recorded, found.what) == (None, "drive, TPDO 5")
    assert "the log lacks the drive, TPDO 5 (221h)" in str(found)


def test_an_answer_to_a_read_is_named_by_its_object() -> None:
    log = friction_run()
    place = next(
        p for p in places(log, SDO_FROM) if log[p][1].data[:4] == bytes((0x43, 0x18, 0x10, 2))
    )
    found = first_difference(changed(log, place, 4, log[place][1].data[4] ^ 1))
    assert found.what == "SDO answer"
    assert found.fields[0].name == "Identity object.Product code"


@pytest.mark.parametrize(("can_id", "own"), [(DRIVE, 1), (0x701, 0)])
def test_frames_before_the_boot_up_are_not_judged(can_id: int, own: int) -> None:
    log = friction_run()
    before = [(0, Frame(SYNC)), (0, Frame(can_id, bytes(8)))]
    found = replayed(before + [(time + 1_000_000, frame) for time, frame in log])
    assert found.begun_s == pytest.approx(1.0, abs=1e-3)
    assert found.drives == replayed(log).drives
    assert [part.frames for part in found.unjudged] == [1] * own
    assert found.unjudged_share == pytest.approx(own / found.ended_s, rel=1e-3)


def test_a_reset_is_as_good_as_a_power_on() -> None:
    log = clocked_run(reset=True)
    whole = replayed(log, lockstep=False)
    assert (whole.power_ons, whole.drives) == (1, len(places(log, DRIVE)))
    reset = next(p for p in places(log, 0) if log[p][1].data[0] == 0x81)
    second = replayed(log[reset - 300 :], lockstep=False)
    assert second.power_ons == 1
    assert second.drives == len(places(log[reset:], DRIVE)) > 400


def test_replay_hears_frames_queued_at_the_reset_after_boot_up() -> None:
    """The node acts on the reset before it looks at the next frame, which is in the log already."""
    log = clocked_run(reset=True)
    reset = places(log, 0)[-3]
    assert log[reset][1].data[0] == 0x81
    boot_up = next(p for p in places(log, BOOT_UP) if p > reset)
    request = next(p for p in places(log, SDO_TO) if p > boot_up)
    start = next(p for p in places(log, 0) if p > boot_up and log[p][1].data[1] in (0, 32))
    for waited in ({request}, {start, request}):
        behind = [log[p] for p in range(boot_up, len(log)) if p not in waited]
        early = [*log[reset - 300 : boot_up], *(log[p] for p in sorted(waited)), *behind]
        found = replayed(early, lockstep=False)
        assert found.drives == len(places(log[reset:], DRIVE)) > 400


def clocked_bus() -> tuple[Log, LocalBus, LocalMaster, StimulatorNode]:
    """A plate, and a stimulator that runs by the clock, with a master and the log of their bus."""
    log: Log = []
    bus = LocalBus(log=lambda *frame: log.append(frame))
    master = LocalMaster(bus, lambda frame: None)
    bus.attach(PlateNode(plate_od(), deadline_ms=DEADLINE_MS), lockstep=False)
    node = clocked_node()
    bus.attach(node, lockstep=False)
    return log, bus, master, node


def waiting_run() -> Log:
    """By the clock, with 3 s of SYNCs and heartbeats of the plate before the start."""
    log, bus, master, node = clocked_bus()
    bus.advance(600_000)
    master.write(STIMULATOR_ID, node.od["Drive unwatched"], 1)
    bus.advance(3_000_000)
    _drive(bus.advance, master, node)
    return log


def test_replay_hears_heartbeats_while_only_sync_is_sent() -> None:
    log = waiting_run()
    found = replayed(log, lockstep=False)
    assert not found.unjudged
    assert found.drives == len(places(log, DRIVE)) > 400


def test_a_log_without_judged_drives_says_why() -> None:
    log = [
        item for item in waiting_run() if item[1].can_id != 0x700 + PLATE_ID or item[0] < 700_000
    ]
    with pytest.raises(ValueError, match=r"no drive of node 32 could be judged: .* only the clock"):
        replayed(log, lockstep=False)


def test_a_node_that_was_switched_off_and_on_begins_anew() -> None:
    log = friction_run()
    again = [(time + 10_000_000, frame) for time, frame in log]
    found = replayed(log + again)
    assert (found.power_ons, found.drives) == (2, 2 * replayed(log).drives)


def test_a_log_without_a_boot_up_is_refused() -> None:
    log = friction_run()
    with pytest.raises(ValueError, match="no boot-up message of node 32"):
        replayed(log[1000:])


def test_replay_does_not_start_at_a_reset_communication() -> None:
    log = friction_run()
    start = places(log, BOOT_UP)[0]
    reset = (log[start][0], Frame(0, bytes((0x82, 32))))
    with pytest.raises(ValueError, match="no boot-up message of node 32"):
        replayed([*log[:start], reset, *log[start:]])
    reset = (log[start][0], Frame(0, bytes((0x81, 32))))
    assert replayed([*log[:start], reset, *log[start:]]).drives > 500


def test_a_log_without_sync_is_refused() -> None:
    log = [item for item in friction_run() if item[1].can_id != SYNC]
    with pytest.raises(ValueError, match=r"no drive of node 32 .* needs SYNC, the measurements"):
        replayed([item for item in log if not 0x180 <= item[1].can_id < 0x500])


def test_time_that_runs_backwards_is_refused() -> None:
    log = friction_run()
    with pytest.raises(ValueError, match="time runs backwards after frame 2000"):
        replayed([*log[:2000], *((time - 10_000_000, frame) for time, frame in log[2000:])])


@pytest.mark.parametrize("drift", [0.0, 80e-6, -80e-6])
def test_a_run_by_the_clock_is_the_same_to_the_bit(drift: float) -> None:
    log = [(round(time * (1 + drift)), frame) for time, frame in clocked_run()]
    found = replayed(log, lockstep=False)
    drives = places(log, DRIVE)
    assert found.drives == len(drives) > 480
    assert len({log[place][1].data[:6] for place in drives}) > 100


def test_the_clock_of_a_logger_may_be_another_one() -> None:
    """After 20 s it is off by almost two periods of SYNC, none of which was missed."""
    log: Log = []
    bus = LocalBus(log=lambda *frame: log.append(frame))
    master = LocalMaster(bus, lambda frame: None)
    node = clocked_node()
    bus.attach(node, lockstep=False)
    bus.advance(20_000_000)
    assert master.read(STIMULATOR_ID, node.od["Cycle.Missed deadlines"]) == 0
    assert sum(frame.can_id == SYNC for _, frame in log) == 20_000
    for drift in (90e-6, -90e-6):
        replay = Replay(clocked_node, STIMULATOR_ID, lockstep=False)
        for time, frame in log:
            replay.take(round(time * (1 + drift)), frame)
        with pytest.raises(ValueError, match="no drive of node 32"):
            replay.end()


def test_frames_of_timers_may_wait_for_those_of_the_loop() -> None:
    """A frame of a timer is not urgent: on a full bus the drives of some cycles go before it."""
    log = clocked_run()
    pick = random.Random(1)
    stamped = []
    moved = 0
    for time, frame in log:
        late = frame.can_id in (0x2A0, 0x3A0, 0x4A0) and pick.random() < 0.7
        moved += late
        stamped.append((time + (5200 if late else pick.randrange(40)), frame))
    stamped.sort(key=lambda item: item[0])
    assert moved > 5
    assert replayed(stamped, lockstep=False).drives == len(places(log, DRIVE))


def test_replay_compares_frames_sent_by_timers() -> None:
    log = clocked_run()
    place = places(log, 0x2A0)[3]
    found = first_difference(changed(log, place, 0, log[place][1].data[0] ^ 1), lockstep=False)
    assert (found.number, found.what) == (place + 1, "TPDO 2")
    assert found.fields[0].name == "Contact.Tangential force"


def test_replay_skips_measurements_before_the_start_of_the_node() -> None:
    """The first one after the start is on the bus, and the node has not heard it."""
    log = clocked_run()
    first = places(log, 0x1A1)[0]
    unheard = [
        (log[first][0] - 20 + n, Frame(can_id, log[place][1].data))
        for n, (can_id, place) in enumerate(
            (can_id, places(log, can_id)[40]) for can_id in (0x1A1, 0x2A1, 0x3A1)
        )
    ]
    started = max(place for place in places(log, 0) if place < first)
    assert started < first
    found = replayed([*log[:first], *unheard, *log[first:]], lockstep=False)
    assert found.drives == len(places(log, DRIVE))


@pytest.mark.parametrize("late", [0, 500])
def test_replay_answers_a_read_behind_the_first_measurement_late(late: int) -> None:
    """Before its SYNC of the next tick or behind it: the first drive may be late by that."""
    log = clocked_run()
    measured, drive = places(log, 0x3A1)[0], places(log, DRIVE)[0]
    status = drive + 1
    asked = log[measured][0]
    read = (asked + 1, READ)
    live = (log[status][0] + late + 1, LIVE)
    moved = [(log[place][0] + late, log[place][1]) for place in (drive, status)]
    rest = [item for place, item in enumerate(log) if place not in (drive, status)]
    busy = sorted([*rest, read, *moved, live], key=lambda item: item[0])
    assert log[status + 1][1].can_id == SYNC
    assert (busy.index(moved[0]) > busy.index(log[status + 1])) == (late > 0)
    assert replayed(busy, lockstep=False).drives == len(places(log, DRIVE))


def test_replay_answers_a_read_within_a_measurement_first() -> None:
    """Its answer shows that the first frame of the measurement was received, and the rest not."""
    log = clocked_run()
    measured, drive = places(log, 0x1A1)[5], places(log, DRIVE)[5]
    asked = log[measured][0]
    parts = [(asked, READ), (asked + 1, LIVE)]
    busy = [*log[: measured + 1], *parts, *log[measured + 1 :]]
    assert log[measured + 1][1].can_id == 0x2A1
    assert measured < drive
    assert replayed(busy, lockstep=False).drives == len(places(log, DRIVE))


def test_replay_hears_a_start_with_the_frames_behind_it() -> None:
    """Of the node nothing but its SYNC is between its start and its first drive."""
    log = clocked_run()
    drive, start = places(log, DRIVE)[0], places(log, 0)[1]
    assert log[start][1].data == bytes((1, 32))
    behind = log[places(log, 0x1A1)[0]][0] - 1
    late = [(max(time, behind), f) if f is log[start][1] else (time, f) for time, f in log]
    late.sort(key=lambda item: item[0])
    written = (log[drive][0] - 1, Frame(SDO_TO, bytes.fromhex("2B102001E8030000")))
    answer = (log[drive][0] + 1, Frame(SDO_FROM, bytes.fromhex("6010200100000000")))
    busy = sorted([*late, written, answer], key=lambda item: item[0])
    assert replayed(busy, lockstep=False).drives == len(places(log, DRIVE))


@pytest.mark.parametrize("still_ms", [15, 40, 80])
def test_a_process_may_stand_still_while_it_says_nothing(still_ms: int) -> None:
    """It hears the queued frames when it goes on, in order: the drive, then the answer."""
    log = clocked_run()
    measured, drive = places(log, 0x3A1)[0], places(log, DRIVE)[0]
    asked = log[measured][0] + 1
    read = (asked, READ)
    live = (log[drive + 1][0] + 1, LIVE)
    others = [(asked + 1000 * n, Frame(0x701, b"\5")) for n in range(still_ms)]
    later = [*log[drive : drive + 2], live, *log[drive + 2 :]]
    replay = Replay(lambda: clocked_node(deadline_ms=100), STIMULATOR_ID, lockstep=False)
    late = [(time + 1000 * still_ms, frame) for time, frame in later]
    for stamped in [*log[:drive], read, *others, *late]:
        replay.take(*stamped)
    assert replay.end().drives == len(places(log, DRIVE))


def test_a_process_in_lockstep_may_stand_still_for_any_time() -> None:
    log = friction_run()
    place = places(log, DRIVE)[200] - 1
    late = [(time + 3_000_000 * (n >= place), frame) for n, (time, frame) in enumerate(log)]
    assert replayed(late).drives == replayed(log).drives


@pytest.mark.parametrize("byte", [0, 7])
def test_one_byte_of_a_drive_by_the_clock_is_named(byte: int) -> None:
    log = clocked_run()
    place = places(log, DRIVE)[300]
    found = first_difference(
        changed(log, place, byte, log[place][1].data[byte] ^ 1), lockstep=False
    )
    assert found.number == place + 1
    assert found.fields[0].name == ("Drive.Voltage", "Drive.Check")[byte == 7]


# A frame without proof is a difference or not judged, and never the same.


OWN = (DRIVE, 0x0A0, 0x1A0, 0x2A0, 0x3A0, 0x4A0, SDO_FROM, BOOT_UP)


def at_0_v(log: Log, place: int) -> Log:
    """Return a log in which one drive is 0 V."""
    time, frame = log[place]
    return [*log[:place], (time, Frame(DRIVE, bytes(2) + frame.data[2:])), *log[place + 1 :]]


def silent_after(log: Log, place: int) -> Log:
    """Return a log in which the node sends nothing behind a place."""
    return log[: place + 1] + [one for one in log[place + 1 :] if one[1].can_id not in OWN]


def driven(log: Log) -> int:
    """Place of a drive with a voltage, of which there are many."""
    with_voltage = [place for place in places(log, DRIVE) if any(log[place][1].data[:2])]
    assert len(with_voltage) > 100
    return with_voltage[len(with_voltage) // 5]


@pytest.mark.parametrize("lockstep", [True, False])
@pytest.mark.parametrize(
    "falsify",
    [
        at_0_v,
        lambda log, place: at_0_v(log, place)[: place + 1],
        lambda log, place: silent_after(at_0_v(log, place), place),
    ],
    ids=["alone", "cut behind it", "silent behind it"],
)
def test_a_drive_changed_to_0_v_differs(falsify: Callable[[Log, int], Log], lockstep: bool) -> None:
    log = friction_run() if lockstep else clocked_run()
    place = driven(log)
    found = first_difference(falsify(log, place), lockstep=lockstep)
    assert (found.number, found.fields[0].name) == (place + 1, "Drive.Voltage")


def test_a_silent_node_differs_in_lockstep() -> None:
    log = friction_run()
    found = first_difference(silent_after(log, driven(log)))
    assert (found.recorded, found.what) == (None, "drive, TPDO 5")


def test_the_next_sync_proves_that_frames_lack_in_lockstep() -> None:
    """The bench waits for the answers of a cycle before it sends SYNC."""
    log = friction_run()
    place = driven(log)
    rest = silent_after(log, place)
    behind = next(p for p in places(rest, SYNC) if p > place)
    assert replayed(rest[:behind]).unjudged == ()
    found = first_difference(rest[: behind + 1])
    assert (found.recorded, found.what) == (None, "TPDO 2")


@pytest.mark.parametrize("byte", [2, 7])
def test_a_spoiled_shutdown_differs(byte: int) -> None:
    log = friction_run()
    place = places(log, DRIVE)[-1]
    found = first_difference(changed(log, place, byte, log[place][1].data[byte] ^ 0x11))
    assert found.number == place + 1


def test_a_spoiled_frame_behind_a_shutdown_differs() -> None:
    log = friction_run()
    place = places(log, DRIVE)[-1]
    found = first_difference(changed(log, place + 1, 0, log[place + 1][1].data[0] ^ 1))
    assert found.number == place + 1


def test_a_torn_shutdown_is_not_judged() -> None:
    found = replayed(friction_run()[:-1])
    [part] = found.unjudged
    assert part.why == "node 32 ends at 0 V without all the frames of a shutdown"


def test_a_node_shut_down_within_a_cycle_is_the_same() -> None:
    """SYNC and measurement are in the log already, and the node has not received them."""
    log = friction_run()
    end = places(log, DRIVE)[-1]
    at = log[end][0]
    sync = places(log, SYNC)[-1]
    unheard = [(at - 5, Frame(SYNC))]
    for n, can_id in enumerate((0x1A1, 0x2A1, 0x3A1)):
        data = log[places(log, can_id)[-1]][1].data
        unheard.append((at - 4 + n, Frame(can_id, data)))
    tick = unheard[1][1].data[4] + 1 & 0xFF
    time, frame = unheard[1]
    unheard[1] = time, Frame(frame.can_id, frame.data[:4] + bytes((tick,)) + frame.data[5:])
    assert sync < end
    # The measurement is of the next tick, and has no right check: the node has no time to see it.
    assert replayed([*log[:end], *unheard, *log[end:]]).unjudged == ()


def test_a_silent_node_is_not_judged_in_real_time() -> None:
    log = foreign_sync_run()
    place = driven(log)
    rest = silent_after(log, place)
    found = replayed(rest, lockstep=False, node=follower)
    [part] = found.unjudged
    assert part.why == "node 32 answers no measurement"
    assert part.begun_s == pytest.approx((log[place][0] - log[0][0]) * 1e-6, abs=2e-3)
    assert part.ended_s == found.ended_s
    assert found.unjudged_share == pytest.approx(1 - part.begun_s / found.ended_s)


def test_a_log_may_end_within_the_deadline() -> None:
    log = foreign_sync_run()
    place = driven(log)
    last = [p for p in places(log, SYNC) if p > place][DEADLINE_MS - 1]
    assert replayed(silent_after(log, place)[:last], lockstep=False, node=follower).unjudged == ()


@pytest.mark.parametrize(("seconds", "silent"), [(0.9, False), (1.2, True)])
def test_a_node_without_heartbeats_is_not_judged(seconds: float, silent: bool) -> None:
    """It produces SYNC itself, so there are no measurements that it would have to answer."""
    log = clocked_run()
    end = log[-1][0]
    others = [(end + 10_000 * n, Frame(0x701, b"\5")) for n in range(round(seconds * 100))]
    found = replayed(log + others, lockstep=False)
    assert [part.why for part in found.unjudged] == ["node 32 sends nothing"] * silent


def test_a_shutdown_in_real_time_is_not_judged() -> None:
    log, bus, master, node = clocked_bus()
    _drive(bus.advance, master, node)
    bus.shutdown()
    found = replayed(log, lockstep=False)
    assert found.drives == len(places(log, DRIVE)) > 400
    [part] = found.unjudged
    assert part.why.startswith("node 32 ends at 0 V")
    # With a voltage instead it differs.
    place = places(log, DRIVE)[-1]
    assert first_difference(changed(log, place, 0, 1), lockstep=False).number == place + 1


# In real time SYNC of another node, deadlines, and counts of the node.


def follower() -> StimulatorNode:
    return StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, deadline_ms=DEADLINE_MS)


@functools.cache
def _foreign_sync_run(lost: int) -> tuple[tuple[int, Frame], ...]:
    log: Log = []
    bus = LocalBus(log=lambda *frame: log.append(frame))
    master = LocalMaster(bus, lambda frame: None)
    plate = bus.attach(PlateNode(plate_od(), deadline_ms=DEADLINE_MS), lockstep=False)
    node = follower()
    bus.attach(node, lockstep=False)

    def advance(microseconds: int) -> None:
        for _ in range(microseconds // 1000):
            bus.advance(1000)
            master.sync()

    _drive(advance, master, node)
    if lost:
        plate.close()
        advance(lost * 1000)
    master.read(STIMULATOR_ID, node.od["Cycle.Missed deadlines"])
    return tuple(log)


def foreign_sync_run(*, lost: int = 0) -> Log:
    """Half a second with SYNC of the master, and then so many ticks without the plate."""
    return list(_foreign_sync_run(lost))


def test_a_run_with_sync_of_a_master_is_the_same() -> None:
    log = foreign_sync_run()
    found = replayed(log, lockstep=False, node=follower)
    assert found.drives == len(places(log, DRIVE)) > 400
    assert found.unjudged == ()


def test_a_lost_plate_trips_in_the_replay_too() -> None:
    log = foreign_sync_run(lost=20)
    codes = [log[place][1].data[:2].hex() for place in places(log, 0x0A0)]
    assert codes == ["5182", "5082", "5082", "5082"]
    assert not any(log[places(log, DRIVE)[-1]][1].data[:2])
    found = replayed(log, lockstep=False, node=follower)
    assert found.compared == sum(frame.can_id in OWN for _, frame in log)
    assert found.unjudged == ()


@pytest.mark.parametrize(
    ("code", "judged"), [("5182", False), ("4182", False), ("1352", True)], ids=str
)
def test_a_fault_that_only_the_clock_decides_is_not_judged(code: str, judged: bool) -> None:
    """Nothing in the log is late; the process of the node was, and it says so."""
    log = foreign_sync_run()
    place = driven(log)
    emcy = (log[place][0], Frame(0x0A0, bytes.fromhex(code) + bytes(6)))
    falsified = [*log[: place + 1], emcy, *log[place + 1 :]]
    if judged:
        found = first_difference(falsified, lockstep=False, node=follower)
        assert (found.number, found.what) == (place + 2, "EMCY")
    else:
        [part] = replayed(falsified, lockstep=False, node=follower).unjudged
        assert part.why == "after a fault that only the clock of the node decides"
        assert part.frames == sum(frame.can_id in OWN for _, frame in log[place + 1 :]) + 1


def test_a_fault_that_the_log_lacks_is_not_judged() -> None:
    """By SYNC the deadline is over. The node did not find so, and goes on."""
    log = foreign_sync_run(lost=20)
    emcy = places(log, 0x0A0)[0]
    last = max(place for place in places(log, DRIVE) if place < emcy - 1)
    others = [one for one in log[last + 1 :] if one[1].can_id not in OWN]
    read = places(log, SDO_FROM)[-1]
    answered = sorted([*others, log[read]], key=lambda one: one[0])
    found = replayed([*log[: last + 1], *answered], lockstep=False, node=follower)
    assert [part.why for part in found.unjudged] == [
        "after a fault that only the clock of the node decides"
    ]


def test_replay_takes_missed_deadlines_from_the_node() -> None:
    log = foreign_sync_run()
    place = places(log, SDO_FROM)[-1]
    assert replayed(changed(log, place, 4, 7), lockstep=False, node=follower).unjudged == ()
    found = first_difference(changed(log, place, 3, 3), lockstep=False, node=follower)
    assert found.number == place + 1
