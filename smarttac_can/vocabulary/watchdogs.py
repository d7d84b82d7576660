"""Table of the watchdogs of the stimulator: input, bound, count, and emergency of each one."""

from __future__ import annotations

from enum import Enum, IntEnum
from math import inf
from typing import Final, NamedTuple

from smarttac_can.canopen.od.cia import ErrorRegister
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import Mode

ALL_MODES: Final = tuple(Mode)
TRACKING_MODES: Final = (Mode.AMPLITUDE_RESONANCE, Mode.FRICTION, Mode.TEXTURE)
"""Modes that track the resonance."""
JUDGED_MODES: Final = tuple(mode for mode in Mode if mode not in (Mode.OFF, Mode.IDENTIFY))
"""Modes in which missing vibration is detected; the others have no voltage, or no model yet."""
FORGOTTEN: Final = 20
"""Number of sound cycles that cancel a faulty one in a leaky bucket."""
STUCK_WITHIN: Final = 2
"""Counts by which samples of a stuck gauge or pick-up may differ, due to converter noise."""
STUCK_GAUGE_CYCLES: Final = 24
"""Samples of gauge or pick-up in a row, within `STUCK_WITHIN` of the first one, that are a fault;
9e-11 false alarms an hour."""
STUCK_THERMOMETER_CYCLES: Final = 100
"""Equal samples of the thermometer in a row that are a fault. With noise of half a count, 0.68 of
the samples are equal; 1e-10 false alarms an hour."""
SATURATED_CYCLES: Final = 2
PICKUP_END_CYCLES: Final = 6
AMPLITUDE_CYCLES: Final = 5
GAUGE_CYCLES: Final = 5
EXCESS_CYCLES: Final = 3
SILENT_CYCLES: Final = 10
LACK_CYCLES: Final = 20
UNSEEN_CYCLES: Final = 5
RESONANCE_CYCLES: Final = 100


def sync_window(deadline_ms: int) -> int:
    """Return the number of periods over which SYNCs are counted: 8 for a deadline of 3 ms."""
    return 2 * deadline_ms + 2


def sync_tolerance(deadline_ms: int) -> int:
    """Return the number of SYNCs too many or too few in a window that is no fault."""
    return deadline_ms - 1


SYNC_DRIFT_WINDOW: Final = 1000
"""Number of periods over which SYNCs are counted to detect a drift of their clock."""


def sync_drift_tolerance(deadline_ms: int) -> int:
    """Return the number of SYNCs too many or too few in the long window that is no fault.

    1 % is more than the error of any quartz (0.01 %), and more than the SYNCs missed by a producer
    without real-time privileges (0.85 %). The deadline is added, as the first or the last SYNC may
    have been received that much late.
    """
    return SYNC_DRIFT_WINDOW // 100 + deadline_ms


class Watchdog(IntEnum):
    """Watchdogs; the number is the bit in Diagnosis.Present and Diagnosis.Latched."""

    NMT = 0
    HEARTBEAT = 1
    MEASUREMENT = 2
    SETPOINT = 3
    SYNC_LOST = 4
    SYNC_IRREGULAR = 5
    SYNC_COUNTER = 6
    BUS_OFF = 7
    TRANSMIT_QUEUE = 8
    VOLTAGE = 9
    AMPLITUDE = 10
    TEMPERATURE = 11
    NORMAL_FORCE = 12
    LATERAL_FORCE = 13
    SATURATED = 14
    STUCK = 15
    GAUGES = 16
    PICKUP = 17
    RESONANCE = 18
    CONTROLLER = 19
    CALIBRATION = 20
    PLATE = 21
    DOUBLE = 22
    UNSEEN = 23
    MISSED_TIME = 24
    STAGE = 25
    NOT_ENABLED = 26


class Way(Enum):
    """Ways in which a watchdog counts faulty cycles, and lowers the count."""

    ONCE = "no count: the first one trips"
    SLOWLY = f"slowly: {FORGOTTEN} cycles without this fault take back one faulty cycle"
    """A leaky bucket, `nodes.watches.leaked`: faulty cycles with gaps add up to a fault, too."""
    IN_A_ROW = "at once"
    WINDOW = "with each window"
    TIME_OUT = "at once: the timer starts again when the late frame comes"


class Count(NamedTuple):
    """One count of faulty cycles; a watchdog may have several."""

    what: str
    """Name of the condition that makes a cycle faulty."""
    way: Way
    cycles: int
    """Number of faulty cycles in a row that is a fault, 1 or more."""
    waits: bool = False
    """Whether the deadline of the loop minus 3 ms is added to the number."""
    modes: tuple[Mode, ...] = ALL_MODES
    """Modes in which it counts; in other modes the count is cleared."""


class WatchdogRow(NamedTuple):
    """Input of a watchdog, its count, the emergency that it reports, and the reasons."""

    text: str
    """Description of the fault, shown as the Message."""
    code: FaultCode
    register: ErrorRegister
    """Bit of the error register in addition to the generic one."""
    bound: int | str
    """Cycles from the first faulty one to 0 V; the name of an object if that sets it."""
    why: str
    """Reason for the bound."""
    way: Way
    rule: str = ""
    """Difference from the way of counting, with its reason; it is appended to the text of the
    way."""
    limit: str = ""
    """Object with the limit."""
    remedy: str = ""
    """Action of a user before the reset."""
    looks_at: str = ""
    """Supervised values, and the states or modes in which they are supervised, if not all."""
    counts: tuple[Count, ...] = ()
    """Counts that are stepped in every cycle."""
    lasting: bool = True
    """Whether the fault stays present until a sound value comes, and blocks the reset."""
    shown: bool = False
    """Whether the Message shows the fault even if nothing is latched, because it needs action."""

    @property
    def forgets(self) -> str:
        """Effect of a sound cycle or frame on the count."""
        return self.way.value + self.rule


_COMMUNICATION: Final = ErrorRegister.COMMUNICATION
_MANUFACTURER: Final = ErrorRegister.MANUFACTURER
_DEADLINE: Final = "event timer of RPDO 5 to 7"
_AT_ONCE: Final = "it trips as soon as it is detected"
_ONE_SAMPLE: Final = "one sample is enough: its noise is far below the limit"
WATCHDOGS: Final[dict[Watchdog, WatchdogRow]] = {
    Watchdog.NMT: WatchdogRow(
        "NMT left OPERATIONAL while running",
        FaultCode.NMT_LEFT, _COMMUNICATION, 1, _AT_ONCE,
        Way.ONCE,
        remedy="start the node again by NMT",
        looks_at="NMT while running",
        lasting=False,
    ),
    Watchdog.HEARTBEAT: WatchdogRow(
        "the heartbeat of a supervised node is lost",
        FaultCode.HEARTBEAT_LOST, _COMMUNICATION, "Consumer heartbeat time",
        "the consumer time. A node that boots again counts as lost at once. A node that was "
        "OPERATIONAL counts as lost if its heartbeats have shown another state for 1 s. The "
        "plate node has 2 s, four of its heartbeats, because the PDOs of the plate are "
        "supervised as well",
        Way.TIME_OUT,
        limit="Consumer heartbeat time",
        remedy="see whether the program that drives, and the plate node, run and are on the bus",
        looks_at="heartbeats and boot-ups of supervised nodes, life guarding",
    ),
    Watchdog.MEASUREMENT: WatchdogRow(
        "the measurements of the plate are late",
        FaultCode.MEASUREMENT_LOST, _COMMUNICATION, _DEADLINE,
        "the shortest of the three event timers: the deadline of the loop",
        Way.TIME_OUT,
        ". Unusable measurements add up only if they follow each other without a usable one "
        "between: CAN may deliver a frame twice, and a doubled PDO looks like an incomplete "
        "measurement. If single measurements are unusable, bit 24 adds up the ticks without a "
        "cycle",
        _DEADLINE,
        remedy="see whether the plate node runs, and whether the computer or the bus is too busy",
        looks_at="time since the last answered measurement, in OPERATIONAL; measurements that "
        "are incomplete, corrupt or of another tick",
    ),
    Watchdog.SETPOINT: WatchdogRow(
        "a set-point PDO is late",
        FaultCode.SETPOINT_LOST, _COMMUNICATION, "event timer of RPDO 1 to 4",
        "set by the master; off by default",
        Way.TIME_OUT,
        limit="event timer of RPDO 1 to 4",
        remedy="see whether the master that sends the set-points runs",
        looks_at="RPDO 1 to 4 with an event timer",
    ),
    Watchdog.SYNC_LOST: WatchdogRow(
        "SYNC is lost",
        FaultCode.SYNC_LOST, _COMMUNICATION, _DEADLINE,
        "without SYNC there are no measurements",
        Way.TIME_OUT,
        limit=_DEADLINE,
        remedy="see whether the producer of SYNC runs",
        looks_at="SYNC of another node, from the first SYNC on",
    ),
    Watchdog.SYNC_IRREGULAR: WatchdogRow(
        "SYNC is irregular",
        FaultCode.SYNC_IRREGULAR, _COMMUNICATION, f"4 x ({_DEADLINE}) + 4",
        "SYNCs are counted in windows of two deadlines plus 2 periods. With a deadline of n ms, up "
        "to n - 1 SYNCs too many or too few are accepted in a window: with 3 ms, 6 to 10 SYNCs in "
        "8 ms. A fault that begins late in a window may only be detected in the next one. To "
        "detect a drift of the clock, SYNCs are also counted over 1000 periods, in which up to "
        "10 + n too many or too few are accepted; this takes up to 2000 cycles",
        Way.WINDOW,
        ". An error that is too small for the short window adds up in the window of 1000 periods, "
        "which accepts up to 1.3 % with a deadline of 3 ms",
        _DEADLINE,
        remedy="see what delays the producer of SYNC, and that there is only one",
        looks_at="SYNC of another node against device time",
    ),
    Watchdog.SYNC_COUNTER: WatchdogRow(
        "the SYNC counter has jumped",
        FaultCode.SYNC_COUNTER, _COMMUNICATION, 1, _AT_ONCE,
        Way.ONCE,
        remedy="see whether there is a second producer of SYNC, or frames get lost",
        looks_at="the counter in SYNC",
        lasting=False,
    ),
    Watchdog.BUS_OFF: WatchdogRow(
        "the CAN controller is bus-off",
        FaultCode.BUS_OFF, _COMMUNICATION, 1, _AT_ONCE,
        Way.ONCE,
        remedy="check the cable, the termination and the bit rate",
        looks_at="the CAN controller",
    ),
    Watchdog.TRANSMIT_QUEUE: WatchdogRow(
        "the transmit queue is full",
        FaultCode.TRANSMIT_QUEUE, _COMMUNICATION, 1, _AT_ONCE,
        Way.ONCE,
        remedy="see whether another node acknowledges, and whether the bus is full",
        looks_at="the transmit queue",
        lasting=False,
    ),
    Watchdog.VOLTAGE: WatchdogRow(
        "the controllers ask for more than the voltage limit",
        FaultCode.VOLTAGE, ErrorRegister.VOLTAGE, 1,
        "checked before the drive goes out",
        Way.ONCE,
        limit="Limit.Voltage",
        remedy="lower the set-point, or raise the limit if the stage allows that",
        looks_at="the drive that the controllers command, and the emergency messages of the plate",
    ),
    Watchdog.AMPLITUDE: WatchdogRow(
        "the vibration is above its limit",
        FaultCode.AMPLITUDE, _MANUFACTURER, AMPLITUDE_CYCLES,
        "when a finger lifts, the amplitude overshoots, but for fewer cycles than this bound. "
        "The voltage is 0 V in each cycle above the limit",
        Way.SLOWLY,
        limit="Limit.Amplitude trip",
        remedy="lower the set-point; if that is low, identify the plate again",
        looks_at="amplitude of the pick-up",
        counts=(Count("amplitude", Way.SLOWLY, AMPLITUDE_CYCLES),),
    ),
    Watchdog.TEMPERATURE: WatchdogRow(
        "the plate is too hot",
        FaultCode.TEMPERATURE, ErrorRegister.TEMPERATURE, 1, _ONE_SAMPLE,
        Way.ONCE,
        limit="Limit.Temperature",
        remedy="let the plate cool down",
        looks_at="the thermometer, and the emergency messages of the plate",
    ),
    Watchdog.NORMAL_FORCE: WatchdogRow(
        "the normal force is above its limit",
        FaultCode.NORMAL_FORCE, _MANUFACTURER, 1, _ONE_SAMPLE,
        Way.ONCE,
        limit="Limit.Normal force",
        remedy="press less",
        looks_at="normal force, after the first tare",
    ),
    Watchdog.LATERAL_FORCE: WatchdogRow(
        "the lateral force is above its limit",
        FaultCode.LATERAL_FORCE, _MANUFACTURER, 1, _ONE_SAMPLE,
        Way.ONCE,
        limit="Limit.Lateral force",
        remedy="press less, and stroke more slowly",
        looks_at="size of the lateral force, after the first tare",
    ),
    Watchdog.SATURATED: WatchdogRow(
        "a sensor is at the end of its range",
        FaultCode.SENSOR_SATURATED, _MANUFACTURER, SATURATED_CYCLES,
        "a single sample may be a disturbance. The pick-up has 6 cycles, because the plate "
        "overshoots when a finger lifts. The voltage is 0 V in each of these cycles, and the "
        "vibration of a plate at 0 V falls by two thirds in a cycle",
        Way.SLOWLY,
        remedy="press less; without a finger, check the sensors and their cables",
        looks_at="the bits of sensors that are at the end of their range",
        counts=(
            Count("saturated", Way.SLOWLY, SATURATED_CYCLES),
            Count("pick-up at its end", Way.SLOWLY, PICKUP_END_CYCLES, waits=True),
        ),
    ),
    Watchdog.STUCK: WatchdogRow(
        "a sensor is stuck",
        FaultCode.SENSOR_STUCK, _MANUFACTURER, STUCK_THERMOMETER_CYCLES,
        f"{STUCK_GAUGE_CYCLES} samples of a gauge or the pick-up within {STUCK_WITHIN} counts of "
        f"the first one, or {STUCK_THERMOMETER_CYCLES} equal samples of the thermometer; see false "
        "alarms in Safety",
        Way.IN_A_ROW,
        ": an intact sensor sometimes repeats a sample, because of its noise, and a leaky bucket"
        " would add up these repetitions. A sensor that is stuck for fewer samples than its "
        f"bound is not detected. Its value is then at most {STUCK_GAUGE_CYCLES - 1} ms old, that "
        f"of the thermometer at most {STUCK_THERMOMETER_CYCLES - 1} ms",
        remedy="check the sensors, their amplifiers and cables",
        looks_at="the counts of each sensor",
    ),
    Watchdog.GAUGES: WatchdogRow(
        "the gauges contradict each other",
        FaultCode.GAUGES_IMPLAUSIBLE, _MANUFACTURER, GAUGE_CYCLES,
        "a finger may land or lift between two samples",
        Way.SLOWLY,
        limit="Limit.Gauge mismatch",
        remedy="tare without a finger; if it comes again, check the four gauges",
        looks_at="S3 to S6 compared with each other and with the size of the plate, the lateral "
        "force compared with the normal one; after the first tare",
        counts=(Count("gauges", Way.SLOWLY, GAUGE_CYCLES),),
    ),
    Watchdog.PICKUP: WatchdogRow(
        "the vibration does not follow from the voltage",
        FaultCode.PICKUP_IMPLAUSIBLE, _MANUFACTURER, LACK_CYCLES,
        "too much vibration: 3 cycles, and 10 while the frequency oscillates. No vibration: 10 "
        "cycles, which are ten time constants. Less vibration than any finger can cause: 20 "
        "cycles. By then the force of a new finger is measured as well. With a plate node, the "
        "deadline of the loop in ms minus 3 is added to each number",
        Way.SLOWLY,
        ". Cycles without any vibration add up only if they follow each other without a gap, "
        "because the end of each pulse with a finger on the plate may look like this",
        "Model",
        remedy="check the pick-up and the power stage; identify the plate again",
        looks_at="amplitude of the pick-up compared with drive, model and normal force; too little "
        "vibration is not judged in the modes off and identify",
        counts=(
            Count("excess", Way.SLOWLY, EXCESS_CYCLES, waits=True),
            Count("silent", Way.IN_A_ROW, SILENT_CYCLES, waits=True),
            Count("lack", Way.SLOWLY, LACK_CYCLES, waits=True, modes=JUDGED_MODES),
        ),
    ),
    Watchdog.RESONANCE: WatchdogRow(
        "the resonance is lost",
        FaultCode.RESONANCE, _MANUFACTURER, RESONANCE_CYCLES,
        "from the end of its frequency range the loop needs 50 ms to the resonance; only cycles "
        "with a vibration count",
        Way.SLOWLY,
        ". Cycles at 0 V or without a vibration do not count; a mode that does not track the "
        "resonance sets the count to 0",
        remedy="identify the plate again; if that fails, look for a crack",
        looks_at="phase of the pick-up, in the modes that track the resonance",
        counts=(Count("resonance", Way.SLOWLY, RESONANCE_CYCLES, modes=TRACKING_MODES),),
    ),
    Watchdog.CONTROLLER: WatchdogRow(
        "the controllers gave no finite drive",
        FaultCode.CONTROLLER, _MANUFACTURER, 1, "checked before the drive goes out",
        Way.ONCE,
        remedy="check Model and Controller: one of their values makes no sense",
        looks_at="the drive that the controllers command, and whether they have left their mode",
        lasting=False,
    ),
    Watchdog.CALIBRATION: WatchdogRow(
        "the calibration is missing or that of another plate",
        FaultCode.CALIBRATION, _MANUFACTURER, 1, "the serial number comes with every sample",
        Way.ONCE,
        limit="Calibration.Plate serial number",
        remedy="calibrate this plate, or write its calibration",
        looks_at="serial number of the plate compared with that of the calibration, and whether "
        "the calibration separates both axes",
    ),
    Watchdog.PLATE: WatchdogRow(
        "the plate went to 0 V by itself: its drives were late",
        FaultCode.DRIVE_LOST, _COMMUNICATION, 1,
        "the plate reports 8253h in the cycle after it has gone to 0 V",
        Way.ONCE,
        limit="event timer of the plate's RPDO 1",
        remedy="see whether the computer or the bus is too busy",
        looks_at="emergency messages of the plate",
        lasting=False,
    ),
    Watchdog.DOUBLE: WatchdogRow(
        "another node sends with an identifier of this one or of its plate: two have one node-ID; "
        "clear 3 s after the last such frame",
        FaultCode.DOUBLE, _COMMUNICATION, 1,
        "one frame is enough; a plate node reports such frames for its own identifiers. If the "
        "plate node does not report them, the stimulator adds up surplus measurements in "
        "windows. With a deadline of n ms, a window has 2 n + 2 SYNCs, and n surplus "
        "measurements in a window are a fault. Fewer than n may have been sent for SYNCs that "
        "this node has not received. The fault exists until no such frame has come for 3 s",
        Way.WINDOW,
        ". A surplus measurement is not answered, even if it is no fault",
        _DEADLINE,
        remedy="give one of the two nodes another node-ID, by LSS or --node-id",
        looks_at="frames with identifiers of this node, emergency messages of the plate, number of "
        "measurements for each SYNC",
        shown=True,
    ),
    Watchdog.UNSEEN: WatchdogRow(
        "late drives may make more vibration than their limit",
        FaultCode.UNSEEN, _MANUFACTURER, UNSEEN_CYCLES,
        "the stimulator computes the largest vibration that its drives can cause, and reduces "
        "each drive so that this vibration stays within Limit.Amplitude by drive. But if a drive"
        " comes late, the drive before it acts for longer. With a plate node, the deadline of "
        "the loop in ms minus 3 is added to the number of cycles",
        Way.SLOWLY,
        limit="Limit.Amplitude by drive",
        remedy="lower the set-point; see whether the computer or the bus is too busy",
        looks_at="drives, model, thermometer and normal force, but not the pick-up",
        counts=(Count("unseen", Way.SLOWLY, UNSEEN_CYCLES, waits=True),),
    ),
    Watchdog.MISSED_TIME: WatchdogRow(
        "too many ticks of a second had no cycle",
        FaultCode.MISSED_TIME, _MANUFACTURER, 2000,
        "judged at the end of each second of a run; a fault that begins late in one second may "
        "only show in the next one",
        Way.WINDOW,
        ": the limit is a share of each second",
        "Limit.Missed ticks",
        remedy="see what else the computer does; real time helps",
        looks_at="cycles against device time, while running",
        lasting=False,
    ),
    Watchdog.STAGE: WatchdogRow(
        "the power stage does not put out the commanded voltage",
        FaultCode.STAGE, ErrorRegister.VOLTAGE, 1,
        "the plate reports 3311h in the cycle that detects it: at once for the simulated stage and "
        "for a front end, within 5 cycles if hardware reads the stage back",
        Way.SLOWLY,
        " if hardware reads the stage back; otherwise there is no count",
        remedy="check the power stage and its supply",
        looks_at="emergency messages of the plate",
        lasting=False,
    ),
    Watchdog.NOT_ENABLED: WatchdogRow(
        "hardware does not enable the power stage, or is silent",
        FaultCode.NOT_ENABLED, _MANUFACTURER, 1,
        "the plate reports 9010h in three cases: Enable becomes 0 while the plate drives, the "
        "event timer of the RPDO with Enable elapses, or a voltage is commanded without Enable. "
        "With a front end the plate also reports 9010h after 2 cycles in a row without a "
        "measurement in time, or after a wrong measurement",
        Way.TIME_OUT,
        ". Cycles of a front end without a measurement add up only if they follow each other; if"
        " they are single, bit 24 adds up the ticks without a cycle",
        "event timer of the plate's RPDO 2",
        remedy="check Enable, and that the hardware sends its PDOs",
        looks_at="emergency messages of the plate",
        lasting=False,
    ),
}  # fmt: skip
"""Rows of all watchdogs."""
REPORTED_BY_PLATE: Final[dict[int, Watchdog]] = {
    WATCHDOGS[watchdog].code: watchdog
    for watchdog in (
        Watchdog.VOLTAGE,
        Watchdog.TEMPERATURE,
        Watchdog.PLATE,
        Watchdog.DOUBLE,
        Watchdog.STAGE,
        Watchdog.NOT_ENABLED,
    )
}
"""Watchdogs that a plate node trips itself, by the codes of its emergency messages."""
OF_LATE_DRIVES: Final = frozenset(
    (
        Watchdog.AMPLITUDE,
        Watchdog.SATURATED,
        Watchdog.PICKUP,
        Watchdog.RESONANCE,
        Watchdog.UNSEEN,
    )
)
"""Watchdogs that may trip because the plate keeps an older drive; the Message then mentions it."""

_EVENT_DRIVEN: Final = frozenset(
    (
        *range(Watchdog.NMT, Watchdog.VOLTAGE),
        Watchdog.PLATE,
        Watchdog.DOUBLE,
        Watchdog.MISSED_TIME,
        Watchdog.STAGE,
        Watchdog.NOT_ENABLED,
    )
)
CYCLIC: Final = sum(1 << watchdog for watchdog in Watchdog if watchdog not in _EVENT_DRIVEN)
"""Bits of the watchdogs that check every cycle."""


def watchdogs_in(bits: int) -> list[Watchdog]:
    """Return the watchdogs whose bits are set, in the order of their numbers."""
    return [watchdog for watchdog in Watchdog if bits >> watchdog & 1]


COUNTED: Final = (
    Watchdog.HEARTBEAT,
    Watchdog.MEASUREMENT,
    Watchdog.SETPOINT,
    Watchdog.SYNC_LOST,
    Watchdog.SYNC_IRREGULAR,
    Watchdog.VOLTAGE,
    Watchdog.AMPLITUDE,
    Watchdog.TEMPERATURE,
    Watchdog.NORMAL_FORCE,
    Watchdog.LATERAL_FORCE,
    Watchdog.SATURATED,
    Watchdog.STUCK,
    Watchdog.GAUGES,
    Watchdog.PICKUP,
    Watchdog.RESONANCE,
    Watchdog.DOUBLE,
    Watchdog.UNSEEN,
    Watchdog.MISSED_TIME,
)
"""Watchdogs with a measured or counted level; the others are events."""
PLATE_COUNTED: Final = ("deadline", "wrong checks", "temperature", "voltage")
"""Watchdogs of the plate itself that have a level."""


def level(value: float, limit: float) -> float:
    """Return the level of a value, 1.0 at its limit; inf for a value above 0 with a limit of 0."""
    if limit:
        return value / limit
    return inf if value > 0 else 0.0
