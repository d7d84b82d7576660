"""An attack: a hostile node on the bus of a driven pair, and a master that follows the rules."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from time import perf_counter
from typing import Any, Final

from smarttac_can.assurance.trials.fault_cases import REGULATED
from smarttac_can.assurance.trials.invariants import Invariants
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.master.errors import HeartbeatLostError
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, NMTCommand
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.states import Control, Law, Mode, State, VibrationLaw
from smarttac_can.vocabulary.watchdogs import Watchdog, watchdogs_in

# A master that follows the rules: it drives the pair again and again, whatever other nodes do.


REST_CYCLES: Final = 100
"""Cycles at 0 V before a fault is reset, and between two attempts to reset."""
_LOOK_CYCLES: Final = 10
_FINGER_MN: Final = 500
_NO_SETTING: Final = ("Simulation", "Fault", "AI auto-zero")
_DRAWN: Final = {
    "Setpoint.Voltage": (1000, 5000),
    "Setpoint.Frequency": (4_334_000, 4_344_000),
    "Setpoint.Amplitude": (300, 1800),
    "Setpoint.COF left": (2500, 6000),
    "Setpoint.COF right": (2500, 6000),
    "Friction law": (min(Law), max(Law)),
    "Controller.Vibration law": (min(VibrationLaw), max(VibrationLaw)),
}
"""Objects whose values are drawn for each run, and their bounds; laws are among them."""


class GoodMaster:
    """Arm again after a disarm, and reset a fault after 100 cycles at 0 V.

    Before it arms, it restores the initial configuration of both nodes: changed communication
    objects by NMT reset communication, the others by SDO.

    Parameters
    ----------
    rig
        Rig with the pair of nodes, started.
    draw
        Generator of modes, laws and set-points.

    Attributes
    ----------
    resets, arms, repairs
        Number of faults reset, of times armed, and of objects restored.
    """

    def __init__(self, rig: Rig, draw: random.Random) -> None:
        self._rig = rig
        self._draw = draw
        self._at_zero = 0
        self.resets = self.arms = self.repairs = 0
        self._nodes = ((STIMULATOR_ID, rig.stimulator), (PLATE_ID, rig.plate))
        rig.start_run(force_mN=_FINGER_MN)
        self._settings = [
            (node_id, entry, entry.read())
            for node_id, node in self._nodes
            for entry in node.od
            if _is_setting(entry)
        ]

    def act(self) -> None:
        """Check the pair after a cycle, and do what is due."""
        rig = self._rig
        self._at_zero = 0 if rig.stage.read() else self._at_zero + 1
        if rig.cycles % _LOOK_CYCLES:
            return
        state = rig.state
        try:
            if state is State.FAULT:
                if self._at_zero >= REST_CYCLES and rig.cycles % REST_CYCLES == 0:
                    self._repair()
                    rig.reset_fault()
                    self.resets += rig.state is not State.FAULT
            elif state is not State.RUNNING:
                self._drive()
            elif not rig.od["Mode"].value:
                rig.write("Mode", self._draw.choice(REGULATED))
        except Abort:
            # The node is not ready yet, or another node was faster; try again later.
            return
        except HeartbeatLostError:
            self.abort_transfers()

    def disarm(self) -> None:
        """Disarm, so that the next `act` configures both nodes and arms again."""
        self._rig.write("Controlword", 0)

    def abort_transfers(self) -> None:
        """Abort open transfers: an open block download takes every request as a segment."""
        for node_id, _ in self._nodes:
            self._rig.master.send(requests.abort(node_id, AbortCode.TIME_OUT))

    def _drive(self) -> None:
        rig, draw = self._rig, self._draw
        self._repair()
        rig.write("Controlword", 0)
        for name, (low, high) in _DRAWN.items():
            rig.write(name, draw.randint(low, high))
        rig.drive(draw.choice(REGULATED))
        self.arms += 1

    def _repair(self) -> None:
        """Restore OPERATIONAL and the configuration of both nodes.

        After a refusal the other objects are still restored, as one of them may be the reason, such
        as a weight on the plate.

        Raises
        ------
        Abort
            The first refusal.
        """
        rig = self._rig
        wrong = [
            (node_id, entry, raw) for node_id, entry, raw in self._settings if entry.read() != raw
        ]
        self.repairs += len(wrong)
        for node_id in {
            node_id for node_id, entry, _ in wrong if entry.index < cia.MANUFACTURER_FIRST
        }:
            rig.nmt(NMTCommand.RESET_COMMUNICATION, node_id)
        if any(node.device.nmt_state is not NMTState.OPERATIONAL for _, node in self._nodes):
            rig.nmt(NMTCommand.START)
            rig.configure()
        refused: Abort | None = None
        for node_id, entry, raw in wrong:
            if entry.index >= cia.MANUFACTURER_FIRST:
                try:
                    rig.master.write(node_id, entry, raw)
                except Abort as abort:
                    refused = refused or abort
        if refused is not None:
            raise refused
        if any(entry.name.startswith("Finger.") for _, entry, _ in wrong):
            rig.start_run(force_mN=_FINGER_MN)


def _is_setting(entry: Entry) -> bool:
    """Return whether an entry is configuration, and neither process data nor drawn for a run."""
    named = entry.name.partition(".")[0] in _NO_SETTING
    return (
        entry.access == "rw"
        and 0 < entry.size <= cia.EXPEDITED_BYTES
        and entry.index != cia.ERROR_FIELD
        and entry.name not in _DRAWN
        and not named
    )


# A third node that sends random frames to any node.


CALM: Final = {
    "SDO read": 300,
    "SDO write": 80,
    "SDO, badly formed": 250,
    "set-point PDO": 30,
    "PDO of others": 120,
    "garbage": 120,
    "extended identifier": 60,
    "remote frame": 60,
    "heartbeat": 20,
    "EMCY": 15,
    "SYNC": 8,
    "NMT or controlword": 10,
}
"""Kinds of frames outside of bursts, with their relative frequency."""
OWN: Final = "identifier of the pair"
"""Kind of the frames of a burst: any frame with an identifier that belongs to one of the nodes."""

_PAIR: Final = (STIMULATOR_ID, PLATE_ID)
_OWN_IDS: Final = (
    *(
        base + node
        for base in (cia.EMCY_ID, *cia.TPDO_IDS, cia.SDO_TX_ID, cia.HEARTBEAT_ID)
        for node in _PAIR
    ),
    cia.RPDO_IDS[0] + PLATE_ID,
)
_COMMAND_IDS: Final = (cia.NMT_ID, cia.RPDO_IDS[0] + STIMULATOR_ID)
_SDO_IDS: Final = tuple(cia.SDO_RX_ID + node for node in _PAIR)
_SETPOINT_IDS: Final = tuple(base + STIMULATOR_ID for base in cia.RPDO_IDS[1:])
_SPARED: Final = ("Simulation", "Fault", "Controlword")
"""Records that SDO does not write; controlwords are sent as commands."""
_LAST_ID: Final = 0x7FF
_LAST_EXTENDED_ID: Final = 0x1FFF_FFFF
_NMT_COMMANDS: Final = tuple(c for c in NMTCommand if c is not NMTCommand.ENTER_PRE_OPERATIONAL)
_CONTROLWORDS: Final = tuple(range(Control.ARM | Control.RUN | Control.QUICK_STOP | 1))
"""Controlwords without the bit of the fault reset."""


class HostileNode:
    """Send random frames of all kinds.

    Parameters
    ----------
    rig
        Rig whose pair of nodes is attacked.
    draw
        Generator of all frames.

    Notes
    -----
    It sends no 80h, neither as an NMT command nor as a controlword, because only the master may
    command pre-operational and reset a fault. It does not write to ``Simulation`` and ``Fault``,
    which no real plate has.
    """

    def __init__(self, rig: Rig, draw: random.Random) -> None:
        self._draw = draw
        self._port = rig.bus.connect(lambda _frame: None)
        self._entries = [
            (node, entry)
            for node, od in zip(_PAIR, (rig.od, rig.plate.od), strict=True)
            for entry in od
        ]
        self._writable = [
            (node, entry)
            for node, entry in self._entries
            if entry.writable and 0 < entry.size <= cia.EXPEDITED_BYTES and not _spared(entry)
        ]
        spared = {entry.index for _, entry in self._entries if _spared(entry)}
        self._spared = {index.to_bytes(2, "little") for index in spared}
        self._makers: dict[str, Callable[[], Frame]] = {
            "SDO read": self._read,
            "SDO write": self._write,
            "SDO, badly formed": self._bad_sdo,
            "set-point PDO": lambda: Frame(self._draw.choice(_SETPOINT_IDS), self._bytes()),
            "PDO of others": self._pdo,
            "garbage": self._garbage,
            "extended identifier": self._extended,
            "remote frame": lambda: Frame(self._draw.randrange(_LAST_ID + 1), rtr=True),
            "heartbeat": lambda: Frame(self._of_others(cia.HEARTBEAT_ID), self._bytes(1)),
            "EMCY": lambda: Frame(self._of_others(cia.EMCY_ID), self._bytes(cia.FRAME_BYTES)),
            "SYNC": lambda: Frame(cia.SYNC_ID, self._bytes(self._draw.randrange(2))),
            "NMT or controlword": self._command,
            OWN: lambda: Frame(self._draw.choice(_OWN_IDS), self._bytes()),
        }
        self._calm = list(CALM), list(CALM.values())

    def act(self, *, own: bool) -> tuple[str, Frame]:
        """Send a frame; return its kind and the frame.

        Parameters
        ----------
        own
            Whether to use an identifier of the pair.
        """
        kind = OWN if own else self._draw.choices(*self._calm)[0]
        frame = self._makers[kind]()
        self._port.send(frame)
        return kind, frame

    def _bytes(self, length: int | None = None) -> bytes:
        return self._draw.randbytes(
            self._draw.randint(0, cia.FRAME_BYTES) if length is None else length
        )

    def _of_others(self, base: int) -> int:
        node = self._draw.choice([n for n in range(1, cia.LAST_NODE_ID + 1) if n not in _PAIR])
        return base + node

    def _pdo(self) -> Frame:
        return Frame(self._of_others(self._draw.choice(cia.TPDO_IDS + cia.RPDO_IDS)), self._bytes())

    def _garbage(self) -> Frame:
        can_id = cia.SYNC_ID
        while can_id in (*_OWN_IDS, *_COMMAND_IDS, *_SDO_IDS, cia.SYNC_ID):
            can_id = self._draw.randrange(_LAST_ID + 1)
        return Frame(can_id, self._bytes())

    def _extended(self) -> Frame:
        can_id = self._draw.randint(_LAST_ID + 1, _LAST_EXTENDED_ID)
        return Frame(can_id, self._bytes(), self._draw.choice((False, True)))

    def _command(self) -> Frame:
        draw = self._draw
        if draw.choice((False, True)):
            node = draw.choice((0, *_PAIR, draw.randrange(256)))
            return requests.nmt(draw.choice(_NMT_COMMANDS), node)
        word = draw.choice(_CONTROLWORDS)
        return Frame(_COMMAND_IDS[1], bytes((word, 0, draw.choice(tuple(Mode)))))

    def _read(self) -> Frame:
        return requests.upload(*self._draw.choice(self._entries))

    def _write(self) -> Frame:
        node, entry = self._draw.choice(self._writable)
        return requests.download(node, entry, self._value(entry))

    def _value(self, entry: Entry) -> int | float:
        """Draw a legal value of an entry: a limit, the present value, or any other."""
        draw = self._draw
        if not isinstance(entry.default, int):
            return draw.uniform(-1.0, 1.0)
        low, high = int(entry.low), int(entry.high)
        return draw.choice((low, high, int(entry.read()), draw.randint(low, high)))

    def _bad_sdo(self) -> Frame:
        """Return an invalid request, or one that does not continue a transfer."""
        draw = self._draw
        can_id = draw.choice(_SDO_IDS)
        length = draw.choice(
            (cia.FRAME_BYTES, cia.FRAME_BYTES, cia.FRAME_BYTES, draw.randrange(cia.FRAME_BYTES))
        )
        data = self._bytes(length)
        if length == cia.FRAME_BYTES and draw.choice((False, True, True)):
            # Any command with an existing object: sizes, segments and blocks that do not fit.
            _, entry = draw.choice(self._entries)
            address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
            data = data[:1] + address + data[4:]
        if data[1:3] in self._spared:
            data = data[:1]
        return Frame(can_id, data)


def _spared(entry: Entry) -> bool:
    return entry.name.partition(".")[0] in _SPARED


VOLTAGE_MAX: Final = 150.0
"""Bound of the stage voltage in V: the limit, which is never raised in a run."""
AMPLITUDE_MAX: Final = 7.5e-6
"""Bound of the vibration in m peak-to-peak: that of the bare plate at this voltage; see the
hazards."""
CYCLES_PER_ACTION: Final = 2.0
"""Mean number of cycles from one action to the next."""
ACTIONS_PER_BURST: Final = 12_500
"""Actions for each burst with the pair's own identifiers, which inhibits both nodes for 3 s."""
BURST_ACTIONS: Final = (1, 200)
RUNNING_MIN: Final = 0.5
"""Least fraction of the cycles in RUNNING, in an attack of at least `ACTIONS_PER_BURST` actions."""
_BACK_CYCLES: Final = 5000
"""Cycles within which the pair drives again after the attack: 3 s after a burst, and resets."""
_UM_PER_M: Final = 1e6


@dataclass
class HostileReport:
    """Actions and results of an attack."""

    seed: int
    actions: dict[str, int] = field(default_factory=dict)
    """Number of frames sent, by kind."""
    cycles: int = 0
    running_share: float = 0.0
    """Fraction of the cycles in RUNNING."""
    running_share_alone: float = 0.0
    """Fraction of the cycles in RUNNING, without those in which the watchdog DOUBLE inhibits."""
    driven_share: float = 0.0
    """Fraction of the cycles with a voltage."""
    faults: dict[str, int] = field(default_factory=dict)
    """Number of times that each watchdog was the first to trip."""
    resets: int = 0
    arms: int = 0
    repairs: int = 0
    """Number of objects that the master has restored."""
    peak_um: float = 0.0
    """Largest true vibration of the plate in um peak-to-peak, which the pick-up may not read."""
    peak_v: float = 0.0
    """Largest voltage of the stage in V."""
    violated: int = 0
    violations: list[str] = field(default_factory=list)
    wall_s: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether no invariant was violated."""
        return self.violated == 0

    def as_json(self) -> dict[str, Any]:
        """Return the report as JSON values."""
        return asdict(self) | {"passed": self.passed}


class Hostile:
    """One attack on the in-process bus.

    Parameters
    ----------
    actions
        Number of frames of the hostile node, 1 or more.
    seed
        Seed of all random draws.
    progress
        Function that is called with the fraction that is done, 0..1.
    """

    def __init__(
        self, actions: int, seed: int, progress: Callable[[float], None] = lambda _share: None
    ) -> None:
        if actions < 1:
            raise ValueError(f"actions {actions} is below 1")
        self._actions = actions
        self._progress = progress
        self._draw = draw = random.Random(seed)
        self._rig = rig = Rig(seed=seed)
        self._report = HostileReport(seed)
        self._invariants = Invariants(rig)
        rig.start()
        self._master = GoodMaster(rig, draw)
        self._node = HostileNode(rig, draw)
        self._sent: Counter[str] = Counter()
        self._faults: Counter[str] = Counter()
        self._running = self._driven = self._doubled = 0
        self._latched = False
        self._last = "nothing"

    def run(self) -> HostileReport:
        """Run the attack and return its report."""
        start = perf_counter()
        rig, report = self._rig, self._report
        begin = rig.cycles
        rig.observe = self._observe
        try:
            self._attack()
            report.cycles = rig.cycles - begin
            self._sum_up()
            self._see_what_is_left()
        except Exception as error:  # noqa: BLE001 - whatever it is, a node must not raise it
            self._violate(f"{type(error).__name__}: {error}")
        report.actions = dict(sorted(self._sent.items()))
        report.faults = dict(sorted(self._faults.items()))
        report.resets, report.arms = self._master.resets, self._master.arms
        report.repairs = self._master.repairs
        report.violated = self._invariants.violated
        report.violations = self._invariants.violations
        report.wall_s = round(perf_counter() - start, 2)
        return report

    def _attack(self) -> None:
        rig, draw, total = self._rig, self._draw, self._actions
        bursts = self._bursts()
        rate = 1.0 / CYCLES_PER_ACTION
        for number in range(total):
            kind, frame = self._node.act(own=number in bursts)
            self._sent[kind] += 1
            self._last = f"{kind}, {_text(frame)}"
            while draw.random() >= rate:
                rig.cycle()
                self._master.act()
            rig.cycle()
            self._master.act()
            self._progress((number + 1) / total)

    def _bursts(self) -> set[int]:
        """Draw which actions use an identifier of the pair."""
        draw, total = self._draw, self._actions
        count = max(1, total // ACTIONS_PER_BURST)
        starts = [draw.randrange(total) for _ in range(count)]
        return {first + n for first in starts for n in range(draw.randint(*BURST_ACTIONS))}

    def _observe(self) -> None:
        rig, report = self._rig, self._report
        self._invariants.check()
        volts = rig.stage.si_value
        W = abs(rig.plate_block.plate.W)
        report.peak_v = max(report.peak_v, volts)
        report.peak_um = max(report.peak_um, W * _UM_PER_M)
        if volts > VOLTAGE_MAX:
            self._violate(f"{volts:g} V at the power stage, more than {VOLTAGE_MAX:g} V")
        if W > AMPLITUDE_MAX:
            self._violate(f"a vibration of {W * _UM_PER_M:.2f} um")
        supervisor = rig.stimulator.block.supervisor
        self._running += supervisor.state is State.RUNNING
        self._driven += volts > 0.0
        self._doubled += bool(supervisor.present >> Watchdog.DOUBLE & 1)
        latched = bool(supervisor.latched)
        if latched and not self._latched:
            first = watchdogs_in(supervisor.latched)[0]
            self._faults[first.name] += 1
        self._latched = latched

    def _sum_up(self) -> None:
        report = self._report
        report.running_share = round(self._running / report.cycles, 4)
        alone = report.cycles - self._doubled
        report.running_share_alone = round(self._running / max(1, alone), 4)
        # A short attack still has a burst, whose 3 s may be most of the cycles.
        if self._actions >= ACTIONS_PER_BURST and report.running_share < RUNNING_MIN:
            self._violate(f"running in {100 * report.running_share:.1f} % of the cycles only")
        report.driven_share = round(self._driven / report.cycles, 4)

    def _see_what_is_left(self) -> None:
        """Check that both nodes answer, and that their master can drive them again."""
        rig = self._rig
        self._last = "nothing any more"
        rig.nmt(NMTCommand.START)
        self._master.abort_transfers()
        for node_id, od in ((STIMULATOR_ID, rig.od), (PLATE_ID, rig.plate.od)):
            try:
                rig.master.read(node_id, od.entry(cia.DEVICE_TYPE))
            except (Abort, HeartbeatLostError) as error:
                self._violate(f"node {node_id} is not alive: {error}")
                return
        # The master restores a limit that was lowered meanwhile, perhaps to 0 V, before it arms.
        self._master.disarm()
        for _ in range(_BACK_CYCLES):
            rig.cycle()
            self._master.act()
            if rig.state is State.RUNNING and rig.stage.read():
                return
        self._violate(f"in state {rig.state.name.lower()} {_BACK_CYCLES} cycles after the attack")

    def _violate(self, what: str) -> None:
        self._invariants.violate(f"{what}; before it: {self._last}")


def _text(frame: Frame) -> str:
    """Return a frame in the notation of candump."""
    return f"{frame.can_id:03X}#{'R' if frame.rtr else frame.data.hex().upper()}"
