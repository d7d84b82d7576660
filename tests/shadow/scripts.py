"""Scripts that Hypothesis draws: how the nodes are set up, and what the master and the world do.

Most acts alone would leave the nodes disarmed, so a script begins with a run that drives, and comes
back to one after what ends it. What is written is drawn from the EDS: the values that the limits
allow, their ends, and beside them.
"""

from __future__ import annotations

from typing import Any, Final

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from world import GRATING, GROUPS, LOAD, SAVE, Act, FrontEnd, Setting

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.od.cia import EXPEDITED_BYTES
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.textures import TABLE_NAMES

Script = tuple[Setting, list[Act]]
NODES: Final = (STIMULATOR_ID, PLATE_ID)
DRIVING: Final = tuple(mode for mode in Mode if mode)
_OF_THE_LOOP: Final = (
    "Setpoint", "Limit", "Controller", "Friction law", "Calibration", "Gauge zero", "Gauge null",
    "Model", "Texture", "Drive unwatched", "Tare at power-on", "Mode", "Controlword",
)  # fmt: skip
_SETPOINTS: Final = {
    "Setpoint.Voltage": (0, 6000),
    "Setpoint.Frequency": (4_330_000, 4_348_000),
    "Setpoint.Amplitude": (0, 2500),
    "Setpoint.COF left": (2000, 6000),
    "Setpoint.COF right": (2000, 6000),
    "Setpoint.Boundary": (-1000, 1000),
    "Friction law": (0, 3),
    "Controller.Vibration law": (0, 2),
    "Limit.Voltage": (2000, 15_000),
    "Limit.Amplitude trip": (500, 3270),
    "Limit.Amplitude by drive": (500, 6000),
    "Limit.Normal force": (300, 4000),
    "Limit.Gauge mismatch": (50, 400),
    "Limit.Missed ticks": (5, 50),
    "Model.Gain per volt": (20_000, 90_000),
    "Model.Tau": (6000, 15_000),
    "Texture.Slot": (1, 4),
}
"""What a master may ask for that lets a run go on, or ends it by a watch."""


def _writable(od: Any) -> list[Entry]:
    return [entry for entry in od if entry.writable and 0 < entry.size <= EXPEDITED_BYTES]


_OD: Final = stimulator_od()
_ENTRIES: Final = {STIMULATOR_ID: _writable(_OD), PLATE_ID: _writable(plate_od())}
_LOOP: Final = [entry for entry in _ENTRIES[STIMULATOR_ID] if entry.name.startswith(_OF_THE_LOOP)]
_MAPPABLE: Final = [
    entry.name for entry in _OD if entry.tpdo_mappable and _OD.find(entry.name) is not None
]


def _values(entry: Entry) -> SearchStrategy[int]:
    low, high = int(entry.low), int(entry.high)
    default = int(entry.default)
    ends = sorted({low, high, min(max(default, low), high), min(default + 1, high)})
    return st.sampled_from(ends) | st.integers(low, high)


@st.composite
def _write(draw: st.DrawFn, node_id: int, entries: list[Entry]) -> list[Act]:
    entry = draw(st.sampled_from(entries))
    return [("write", node_id, entry.index, entry.subindex, draw(_values(entry)))]


@st.composite
def _setting_of_a_run(draw: st.DrawFn) -> list[Act]:
    name = draw(st.sampled_from(sorted(_SETPOINTS)))
    return [("put", name, draw(st.integers(*_SETPOINTS[name])))]


@st.composite
def _fault(draw: st.DrawFn) -> list[Act]:
    kind = draw(st.sampled_from(FaultKind))
    sensor = draw(st.integers(1, 10))
    value = draw(st.sampled_from((300, 600, -600, 1500, 6000, 14_000)))
    return [("fault", int(kind), sensor, value, draw(st.integers(0, 10)))]


@st.composite
def _remap(draw: st.DrawFn) -> list[Act]:
    names = draw(st.lists(st.sampled_from(_MAPPABLE), min_size=1, max_size=4))
    steps = draw(st.integers(1, len(names) + 4))
    act = ("remap", STIMULATOR_ID, draw(st.integers(1, 5)), names, steps, draw(st.booleans()))
    return [act, ("cycles", draw(st.integers(0, 5)))]


_SHORT: Final = st.integers(1, 25)
_NODE: Final = st.sampled_from(NODES)
_MODES: Final = st.sampled_from(DRIVING)
_CYCLES: Final = st.sampled_from((0, 1, 5, 20, 60, 150, 400))
_FINGER: Final = st.tuples(st.integers(1, 5), st.integers(100, 1500), st.sampled_from((1, 1, 1, 0)))
_NMT: Final = st.sampled_from((0x01, 0x02, 0x80, 0x81, 0x82))
_DATA: Final = st.binary(max_size=8).map(bytes.hex)
_EIGHT_BYTES: Final = st.binary(min_size=8, max_size=8).map(bytes.hex)
_TABLES: Final = _DATA | st.just(GRATING.hex())
_KINDS: Final = st.sampled_from(("LOSS", "LOSS", "DUPLICATION", "REORDERING", "DELAY"))
_OWN_IDS: Final = (0x1A0, 0x1A1, 0x221, 0x2A1, 0x3A1, 0x5A0, 0x720, 0x721, 0x0A0, 0x0A1)


def _one(*parts: Any) -> SearchStrategy[list[Act]]:
    """Return what draws one act, of a name and of what its arguments are drawn from."""
    drawn = [part if isinstance(part, SearchStrategy) else st.just(part) for part in parts]
    return st.tuples(*drawn).map(lambda act: [act])


def _read(node_id: int) -> SearchStrategy[list[Act]]:
    od = _OD if node_id == STIMULATOR_ID else plate_od()
    entries = [entry for entry in od if entry.readable]
    return st.sampled_from(entries).map(
        lambda entry: [("read", node_id, entry.index, entry.subindex)]
    )


_ACTS: Final[tuple[tuple[int, SearchStrategy[list[Act]]], ...]] = (
    (10, _setting_of_a_run()),
    (6, _write(STIMULATOR_ID, _LOOP)),
    (3, _write(STIMULATOR_ID, _ENTRIES[STIMULATOR_ID])),
    (2, _write(PLATE_ID, _ENTRIES[PLATE_ID])),
    (3, _one("put", "Mode", st.integers(0, 6))),
    (3, _one("put", "Controlword", st.sampled_from((0, 1, 3, 4, 7, 0x80, 0x100)))),
    (3, _one("controlword", st.sampled_from((0, 1, 3, 4, 0x80)), st.integers(0, 6))),
    (3, _one("drive", _MODES)),
    (3, _FINGER.map(lambda finger: [("new_run", *finger)])),
    (4, _one("nmt", _NMT, st.sampled_from((0, *NODES)))),
    (5, _one("disturb", _KINDS, st.sampled_from(sorted(GROUPS)), _SHORT)),
    (1, _one("disturb", "CORRUPTION", st.sampled_from(("drive", "measurement")), _SHORT)),
    (5, _fault()),
    (4, _remap()),
    (2, _one("store", _NODE, st.integers(1, 4), st.just(SAVE))),
    (2, _one("store", _NODE, st.integers(1, 4), st.just(LOAD), st.just(0x1011))),
    (2, _one("power_cycle", _NODE)),
    (2, _one("pause", _NODE, _SHORT)),
    (1, _one("stop_clock", _NODE, _SHORT)),
    (1, _one("jump", _NODE, st.integers(1, 5000))),
    (1, _one("clog", _NODE, _SHORT)),
    (1, _one("bus_off", _NODE, _SHORT)),
    (2, _one("syncs", st.sampled_from((0, 2, 3)), _SHORT)),
    (1, _one("count_syncs")),
    (1, _one("sync_counter", st.integers(1, 5))),
    (1, _one("heartbeat", st.booleans())),
    (1, _one("frame", 0x701, st.sampled_from(("00", "05", "7F", "04")))),
    (1, _one("wait", st.sampled_from((200, 700, 1500, 3000, 20_000)))),
    (2, _one("setpoints", st.integers(2, 4), _DATA)),
    (1, _one("each_cycle", 0x320, "A00F48354200", st.integers(1, 60))),
    (1, _one("frame", st.sampled_from(_OWN_IDS), _DATA)),
    (2, _one("echo", st.sampled_from(sorted(GROUPS)))),
    (1, _one("frame", st.sampled_from((0x720, 0x721)), "", True)),
    (1, _one("frame", st.sampled_from((0x620, 0x621)), _EIGHT_BYTES)),
    (1, _one("connect_hardware", st.integers(0, 1), st.integers(1, 60))),
    (1, _one("write_long", STIMULATOR_ID, _OD[TABLE_NAMES[0]].index, st.integers(1, 4), _TABLES)),
    (1, _one("front_end", st.sampled_from(FrontEnd.BEHAVIOURS))),
    (1, st.sampled_from(NODES).flatmap(_read)),
)  # fmt: skip


_SCENES: Final[SearchStrategy[list[Act]]] = st.one_of(
    st.just([]), *(scene for weight, scene in _ACTS for _ in range(weight))
)
"""The first one is what a scene shrinks to that has nothing to do with a difference."""


_REPAIRS: Final[SearchStrategy[list[Act]]] = st.one_of(
    st.just([]),
    st.just([]),
    _one("recover", _MODES),
    _one("mend", _MODES),
    st.tuples(_FINGER, _MODES).map(lambda drawn: [("anew", *drawn[0], drawn[1])]),
)
"""What a master does behind a scene: nothing, as it goes on, or what lets it drive again."""


@st.composite
def settings_of_nodes(draw: st.DrawFn) -> Setting:
    """Draw how the nodes are set up; two nodes in real time most of all."""
    plate = draw(st.sampled_from(("node", "node", "node", "inside", "hardware")))
    produce = plate != "inside" and draw(st.sampled_from((False, False, False, True)))
    lockstep = not produce and draw(st.sampled_from((False, False, True)))
    return Setting(plate, lockstep, produce, draw(st.sampled_from((3, 3, 20))))


@st.composite
def scripts(draw: st.DrawFn, scenes: int = 30) -> Script:
    """Draw a script of so many scenes, or of fewer."""
    setting = draw(settings_of_nodes())
    begin: list[Act] = [
        ("begin", *draw(_FINGER)),
        ("recover", draw(_MODES)),
        ("cycles", 70),
    ]
    drawn = draw(
        st.lists(
            st.tuples(_SCENES, _CYCLES, _REPAIRS, _CYCLES),
            min_size=draw(st.integers(1, scenes)),
            max_size=scenes,
        )
    )
    acts = [
        act
        for scene, cycles, repair, more in drawn
        for act in (*scene, ("cycles", cycles), *repair, ("cycles", more))
        if act != ("cycles", 0)
    ]
    return setting, [*begin, *acts]
