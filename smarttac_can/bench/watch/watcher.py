"""A listener to a stimulator: frames and time are its input, a view is its output."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache
from typing import Any, Final, NamedTuple

from smarttac_can.bench.link import PUBLIC, PublishedPdo, published_pdos
from smarttac_can.bench.watch.extremes import Extremes
from smarttac_can.bench.watch.wording import limits_in_the_way
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import STATES, NMTState, state_text
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.timing import frame_seconds
from smarttac_can.canopen.od.units import Quantity
from smarttac_can.vocabulary.meanings import emergency_text, spoken
from smarttac_can.vocabulary.states import Mode, State, Status, known_state
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in

PUBLISHED: Final = {
    "Contact.COF": "",
    "Contact.COF reference": "",
    "Contact.Tangential force": "N",
    "Contact.Normal force": "N",
    "Contact.Position": "mm",
    "Vibration.Amplitude": "um",
    "Vibration.Voltage": "V",
    "Vibration.Frequency": "Hz",
    "Plate temperature": "degC",
}
"""Objects in the default TPDOs, with the units in which they are shown."""
READ: Final = {
    "Cycle.Cycles": "",
    "Diagnosis.Latched": "",
    "Setpoint.Voltage": "V",
    "Setpoint.Frequency": "Hz",
    "Setpoint.Amplitude": "um",
    "Setpoint.COF left": "",
    "Setpoint.COF right": "",
    "Setpoint.Boundary": "mm",
    "Friction law": "",
    "Controller.Vibration law": "",
    "Texture.Slot": "",
    "Vibration.W_d": "um",
    "Vibration.W_q": "um",
    "Cycle.Lost cycles": "",
    "Cycle.Missed deadlines": "",
    "Cycle.Foreign ticks": "",
    "Cycle.Corrupt measurements": "",
    "Cycle.Surplus measurements": "",
}
"""Objects in no default TPDO, which are read by SDO in turn, with the units for showing them."""
READ_RARELY: Final = {
    "Limit.Voltage": "V",
    "Limit.Amplitude": "um",
    "Limit.Lowest frequency": "Hz",
    "Limit.Highest frequency": "Hz",
    "Limit.Normal force": "N",
    "Limit.Lateral force": "N",
    "Limit.Temperature": "degC",
    "Model.State": "",
    "Model.Progress": "",
    "Model.Gain per volt": "nm",
    "Model.Tau": "us",
    "Model.Resonance": "Hz",
    "Model.Softening": "Hz/um",
    "Controller.Dead time": "us",
}
"""Objects that change in no run: one of them is read after `_OFTEN` others."""
_OFTEN: Final = 3
FORGOTTEN_S: Final = 5.0
"""Time in s for which a value read by SDO is shown."""
_EMERGENCIES: Final = 6
_HISTORY: Final = 120
_SAMPLE_S: Final = 0.25
SILENT_S: Final = 3.0
"""Time in s without a frame after which a node is silent: three heartbeats by default."""
_SPEAKS: Final = ("", STATES[NMTState.OPERATIONAL])
OLD_S: Final = 2.0
"""Age in s above which a published value is not shown: 20 event times by default."""
_PLACES: Final = range(9)
PAUSE_S: Final = 0.05
"""Pause in s between two reads: load below 0.6 % of a bus of 1 Mbit/s."""
TIMEOUT_S: Final = 0.5
YIELD_S: Final = 0.3
"""Pause in s after a request of another client, as an upload would end its transfer."""
WINDOW_S: Final = 1.0
_STOP_AGAIN_S: Final = 0.1
_ARMED: Final = (State.ARMED, State.RUNNING)


class Watcher:
    """State of a stimulator, from received frames and from SDO reads of unpublished objects.

    It sends only SDO reads of single objects, and none if `reads` is False. The one exception is
    `stop`.

    Parameters
    ----------
    stimulator
        Object dictionary of the stimulator, loaded for its node-ID.
    plate
        Object dictionary of the plate node, loaded for its node-ID; None if the plate is inside the
        stimulator.
    bit_rate
        Bit rate of the bus in bit/s, for its load.
    reads
        Whether objects are read by SDO.

    Attributes
    ----------
    extremes
        Extremes of the objects of `PUBLISHED`; whoever looks at them ends their steps.
    """

    def __init__(
        self,
        stimulator: ObjectDictionary,
        plate: ObjectDictionary | None = None,
        *,
        bit_rate: int = 1_000_000,
        reads: bool = True,
    ) -> None:
        self._od = stimulator
        self._nodes = [HeardNode(stimulator, "stimulator")]
        if plate is not None:
            self._nodes.append(HeardNode(plate, "plate"))
        self.extremes = Extremes(stimulator, PUBLISHED)
        self._published = PublishedValues(stimulator, self.extremes)
        self._reader: SdoReader | None = None
        if reads:
            self._reader = SdoReader(
                stimulator.node_id,
                mapping_entries(stimulator),
                [stimulator[name] for name in (*READ, "Message")],
                [stimulator[name] for name in READ_RARELY],
            )
        self._remapped = False
        self._load = LoadMeter(bit_rate)
        self._emergencies: deque[tuple[float, int, int]] = deque(maxlen=_EMERGENCIES)
        self._history: deque[tuple[float | None, float | None]] = deque(maxlen=_HISTORY)
        self._next_sample = 0.0
        self._cycles: tuple[float, int] | None = None
        self._cycle_rate: float | None = None
        self._began: float | None = None
        self._stop = Stop(stimulator)
        self.lost = ""
        """Reason why there is no bus; empty while there is one."""

    def receive(self, now: float, frame: Frame) -> None:
        """Handle a frame of another party, received at a time in s."""
        self._load.take(now, frame)
        self._published.take(now, frame)
        for node in self._nodes:
            booted = node.take(now, frame)
            if booted and node is self._nodes[0] and self._reader is not None:
                # A reset has restored the default mapping.
                self._reader.restart()
                self._remapped = False
            if frame.can_id == node.emergency_id and len(frame.data) > 1:
                code = int.from_bytes(frame.data[:2], "little")
                self._emergencies.appendleft((now, node.node_id, code))
        if self._reader is not None and self._reader.take(now, frame):
            self._follow(self._reader, now)

    def advance(self, now: float) -> list[Frame]:
        """Advance to a time in s; return the frames to send."""
        if self._began is None:
            self._began = now
            self._published.remap({}, now)
        if now >= self._next_sample:
            self._next_sample = now + _SAMPLE_S
            values = _values(self._od, self._published.at(now), PUBLISHED)
            self._history.append((values.get("Contact.COF"), values.get("Contact.COF reference")))
        shown = self._published.last("Statusword")
        frames = self._stop.frames(now, shown, self._nodes[0].rested)
        request = None if self._reader is None or self.lost else self._reader.request(now)
        if request is not None:
            frames.append(request)
        for frame in frames:
            self._load.take(now, frame)
        return frames

    def stop(self) -> None:
        """Disarm the stimulator: write controlword and mode until it reports that it is not armed.

        Any client may do so, not only the commander.
        """
        self._stop.ask()

    @property
    def stopping(self) -> bool:
        """Whether a stop was requested, and the stimulator has not confirmed it yet."""
        return self._stop.asked

    def view(self, now: float) -> View:
        """Return the view at a time in s."""
        seen = self._published.at(now)
        read = self._raw_read(now)
        load, rate = self._load.at(now)
        return view_of(self._od, seen, read, self._published.older_than_limited())._replace(
            peers=tuple(node.at(now) for node in self._nodes),
            notes=tuple(self._notes(now)),
            cycle_rate=self._cycle_rate if "Cycle.Cycles" in read else None,
            emergencies=tuple(
                Emergency(now - at, node_id, code, emergency_text(code))
                for at, node_id, code in self._emergencies
            ),
            history=tuple(self._history),
            bus_load=load,
            frame_rate=rate,
        )

    def _notes(self, now: float) -> Iterator[str]:
        if self.lost:
            yield f"the bus is lost ({self.lost}); it is opened again as soon as it is there"
            return
        peers = [node.at(now) for node in self._nodes]
        for peer in peers:
            yield from peer.notes(now - (now if self._began is None else self._began))
        if not peers[0].gone:
            yield from self._notes_of_stimulator(now, peers[0])
        if self.stopping:
            yield "stop: written again and again until the stimulator shows that it is disarmed"

    def _notes_of_stimulator(self, now: float, peer: Peer) -> Iterator[str]:
        if peer.nmt == STATES[NMTState.OPERATIONAL]:
            yield from self._published.complaints(now)
        if not self._published.at(now).get("Statusword", Status.LIVE) & Status.LIVE:
            yield "the loop has no cycles: the values are those of the last one"
        if self._reader is not None and self._reader.silent:
            yield f"node {peer.node_id} does not answer SDO: set-points and counts are missing"

    def _raw_read(self, now: float) -> dict[str, Any]:
        reader = self._reader
        if reader is None:
            return {}
        return {
            entry.name: raw for entry, (at, raw) in reader.values.items() if now - at <= FORGOTTEN_S
        }

    def _follow(self, reader: SdoReader, now: float) -> None:
        """Apply the mapping once it is known, and update the rate of the cycles."""
        if reader.begun and not self._remapped:
            self._remapped = True
            self._published.remap({entry: raw for entry, (_, raw) in reader.values.items()}, now)
        last, self._cycles = self._cycles, reader.values.get(self._od["Cycle.Cycles"])
        if self._cycles is not None and last is not None and self._cycles[0] > last[0]:
            time, count = self._cycles[0] - last[0], self._cycles[1] - last[1]
            if count >= 0:
                self._cycle_rate = count / time


class Peer(NamedTuple):
    """State of a node of the instrument, from its frames."""

    node_id: int
    name: str
    nmt: str
    """NMT state; empty while it is not known."""
    silent: float | None
    """Time in s since any frame of it; None if none has come."""

    @property
    def gone(self) -> bool:
        """Whether the node was never received, or has fallen silent."""
        return self.silent is None or self.silent > SILENT_S

    def notes(self, listened: float) -> Iterator[str]:
        """Yield why the node publishes nothing, `listened` s after listening began."""
        who = f"node {self.node_id} ({self.name})"
        if self.silent is None:
            if listened > SILENT_S:
                yield (
                    f"nothing has been heard of {who} for {listened:.0f} s: "
                    "is it running on this bus, with that node-ID?"
                )
        elif self.gone:
            yield f"{who} has been silent for {self.silent:.0f} s: it has stopped or left the bus"
        elif self.nmt not in _SPEAKS:
            yield f"{who} is {self.nmt}: it publishes nothing until a master starts it"


class Emergency(NamedTuple):
    """An emergency message."""

    ago: float
    """Time in s since its reception."""
    node_id: int
    code: int
    text: str


class View(NamedTuple):
    """A stimulator and its bus at one instant; unknown values are None, empty or absent."""

    state: str
    mode: str
    flags: tuple[str, ...]
    """Names of the set bits of the statusword."""
    values: Mapping[str, float]
    """Values by the name of the object, in the units of `PUBLISHED`, `READ` and `READ_RARELY`.

    The position, from the middle of the plate, and the COF are absent while the finger does not
    touch.
    """
    latched: tuple[str, ...]
    """Texts of the latched faults."""
    remedies: tuple[str, ...]
    """What to do about each of them."""
    peers: tuple[Peer, ...] = ()
    notes: tuple[str, ...] = ()
    """Sentences on what is wrong or missing."""
    cycle_rate: float | None = None
    """Cycles per second."""
    emergencies: tuple[Emergency, ...] = ()
    """Emergency messages, newest first."""
    history: tuple[tuple[float | None, float | None], ...] = ()
    """COF and reference at equal intervals, newest last."""
    bus_load: float = 0.0
    """Fraction of the last second in which the bus was busy, with the most stuff bits possible."""
    frame_rate: float = 0.0
    """Number of frames in the last second."""
    limited: Mapping[str, str] = {}
    """Limits that reduce the output, in words, by the object that each one acts on."""
    message: str | None = None
    """Message of the device; None if it is not known."""


def view_of(
    od: ObjectDictionary,
    seen: Mapping[str, int],
    read: Mapping[str, Any],
    older: Collection[str] = (),
) -> View:
    """Return the view of raw values of a stimulator, as far as it follows from them.

    Parameters
    ----------
    od
        Object dictionary of the stimulator.
    seen, read
        Raw values by name, of published objects and of objects read by SDO.
    older
        Names of the published objects whose values are older than the bit LIMITED.
    """
    latched = [WATCHDOGS[each] for each in watchdogs_in(read.get("Diagnosis.Latched", 0))]
    values = _values(od, seen, PUBLISHED) | _values(od, read, READ | READ_RARELY)
    mode = _mode(seen)
    limited = seen.get("Statusword", 0) & Status.LIMITED
    return View(
        state=_state(seen),
        mode=mode,
        flags=tuple(spoken(flag) for flag in Status if seen.get("Statusword", 0) & flag),
        values=values,
        latched=tuple(row.text.partition(":")[0] for row in latched),
        remedies=tuple(row.remedy for row in latched),
        limited=limits_in_the_way(values, mode, older) if limited else {},
        message=read.get("Message"),
    )


@cache
def unit_factor(count: Quantity, symbol: str) -> float:
    """Return a count of an object in a unit; every look takes those of some forty objects."""
    return count.in_unit(symbol)


def _values(
    od: ObjectDictionary, raw: Mapping[str, int], units: Mapping[str, str]
) -> dict[str, float]:
    values = {
        name: raw[name] * unit_factor(od[name].unit, unit)
        for name, unit in units.items()
        if name in raw
    }
    for cof in ("Contact.COF", "Contact.COF reference"):
        if not values.get(cof):
            # 0 means that there is no value.
            values.pop(cof, None)
    if not raw.get("Statusword", 0) & Status.TOUCHING:
        values.pop("Contact.Position", None)
    return values


def _state(seen: Mapping[str, int]) -> str:
    if "Statusword" not in seen:
        return ""
    state = known_state(seen["Statusword"])
    return "unknown" if state is None else spoken(state)


def _mode(seen: Mapping[str, int]) -> str:
    if "Mode display" not in seen:
        return ""
    number = seen["Mode display"]
    return spoken(Mode(number)) if number in list(Mode) else f"number {number}"


class HeardNode:
    """Follows the frames of one node.

    Parameters
    ----------
    od
        Object dictionary of the node, loaded for its node-ID.
    name
        Name of the node for people.

    Attributes
    ----------
    emergency_id
        CAN-ID of its emergency messages.
    rested
        Time in s of its last heartbeat in another state than OPERATIONAL; None before.
    """

    def __init__(self, od: ObjectDictionary, name: str) -> None:
        self.node_id, self.name = od.node_id, name
        self.emergency_id = od.number(cia.EMCY_COB_ID) & cia.CAN_ID_MASK
        cob_ids = [
            od.number(cia.TPDO_COMMUNICATION + offset, cia.PDO_COB_ID, cia.COB_INVALID)
            for offset in range(cia.PDO_COUNT)
        ]
        self._pdo_ids = {cob & cia.CAN_ID_MASK for cob in cob_ids if not cob & cia.COB_INVALID}
        self._nmt: int | None = None
        self._heard: float | None = None
        self.rested: float | None = None

    def take(self, now: float, frame: Frame) -> bool:
        """Handle any frame of the bus; return whether it is the boot-up message of this node."""
        can_id = frame.can_id
        if can_id == cia.HEARTBEAT_ID + self.node_id and frame.data and not frame.rtr:
            self._heard, self._nmt = now, frame.data[0] & 0x7F
            if self._nmt != NMTState.OPERATIONAL:
                self.rested = now
            return self._nmt == NMTState.INITIALISING
        if can_id in self._pdo_ids:
            # Only OPERATIONAL nodes send PDOs; the next heartbeat may be 1 s away.
            self._heard, self._nmt = now, NMTState.OPERATIONAL
        elif can_id in (self.emergency_id, cia.SDO_TX_ID + self.node_id):
            self._heard = now
        return False

    def at(self, now: float) -> Peer:
        """Return the state of the node at a time in s."""
        nmt = "" if self._nmt is None else state_text(self._nmt)
        silent = None if self._heard is None else now - self._heard
        return Peer(self.node_id, self.name, nmt, silent)


def mapping_entries(od: ObjectDictionary) -> Iterator[Entry]:
    """Yield the entries of the mapping of the public TPDOs."""
    for number in PUBLIC:
        yield od.entry(cia.TPDO_COMMUNICATION + number - 1, cia.PDO_COB_ID)
        for place in _PLACES:
            yield od.entry(cia.TPDO_MAPPING + number - 1, place)


class PublishedValues:
    """Last values of the public TPDOs, decoded by the EDS until the mapping was read.

    Parameters
    ----------
    od
        Object dictionary of the stimulator, loaded for its node-ID.
    extremes
        Extremes that take each value.
    """

    def __init__(self, od: ObjectDictionary, extremes: Extremes) -> None:
        self._od = od
        self._extremes = extremes
        self._pdos: dict[int, PublishedPdo] = {}
        self._ill: set[int] = set()
        self._limited = False
        self._in_limited: set[int] = set()
        self._since = 0.0
        self.remap({}, 0.0)

    def remap(self, known: Mapping[Entry, int], now: float) -> None:
        """Decode by the mapping that was read from the node, or else by the EDS.

        Parameters
        ----------
        known
            Raw values of entries of `mapping_entries`.
        now
            Time in s.
        """
        pdos = published_pdos(self._od, lambda entry: known.get(entry, int(entry.default)))
        self._pdos = {pdo.can_id: pdo for pdo in pdos}
        self._ill = set()
        self._limited = False
        self._in_limited = set()
        self._since = now

    def take(self, now: float, frame: Frame) -> bool:
        """Handle any frame of the bus; return whether it is one of the TPDOs."""
        pdo = self._pdos.get(frame.can_id)
        if pdo is None or frame.rtr:
            return False
        if pdo.take(frame.data, now):
            self._ill.discard(pdo.number)
            for name, raw in zip(pdo.names, pdo.values, strict=True):
                self._extremes.take(name, (raw,))
                if name == "Statusword":
                    self._limited = bool(raw & Status.LIMITED)
            if self._limited:
                self._in_limited.add(pdo.number)
            else:
                self._in_limited.discard(pdo.number)
        else:
            self._ill.add(pdo.number)
        return True

    def at(self, now: float) -> dict[str, int]:
        """Return the raw values, by name, that are recent at a time in s."""
        return {
            name: value
            for pdo in self._pdos.values()
            if pdo.received is not None and now - pdo.received <= OLD_S
            for name, value in zip(pdo.names, pdo.values, strict=True)
        }

    def older_than_limited(self) -> set[str]:
        """Return the names of the objects whose last values did not come while LIMITED was set.

        The statusword is sent in the cycle that changes it, other TPDOs up to 100 ms later.
        """
        return {
            name
            for pdo in self._pdos.values()
            if pdo.number not in self._in_limited
            for name in pdo.names
        }

    def last(self, name: str) -> tuple[float, int] | None:
        """Return time in s and raw value of the last reception of an object; None before."""
        for pdo in self._pdos.values():
            if pdo.received is not None and name in pdo.names:
                return pdo.received, pdo.values[pdo.names.index(name)]
        return None

    def complaints(self, now: float) -> Iterator[str]:
        """Yield complaints about TPDOs that are missing or differ in length from their mapping."""
        if not self._pdos:
            yield "none of the TPDOs 1 to 4 is valid: nothing is published"
        for pdo in self._pdos.values():
            last = self._since if pdo.received is None else pdo.received
            if pdo.number in self._ill:
                yield f"TPDO {pdo.number} is not as long as its mapping: it is not decoded"
            elif now - last > OLD_S:
                yield f"TPDO {pdo.number} has not come for {now - last:.0f} s"


class SdoReader:
    """Reads entries in turn, repeatedly; some of them once, before the others.

    Parameters
    ----------
    node_id
        Node-ID of the server.
    once
        Entries of 1 to 4 bytes to read first.
    again
        Entries to read repeatedly: of 1 to 4 bytes, or a text.
    rarely
        Entries of which one is read after `_OFTEN` of the others.

    Attributes
    ----------
    values
        Time in s of the last read, and raw value, of each entry that was not refused.
    silent
        Whether the last request was not answered.
    """

    def __init__(
        self,
        node_id: int,
        once: Iterable[Entry],
        again: Iterable[Entry],
        rarely: Iterable[Entry] = (),
    ) -> None:
        self._node_id = node_id
        self._once, self._again = list(once), list(again)
        self._rarely = deque(rarely)
        self._others = 0
        self.values: dict[Entry, tuple[float, Any]] = {}
        self.silent = False
        self._asked: requests.Upload | None = None
        self._due: Frame | None = None
        self._next = 0.0
        self._deadline = 0.0
        self.restart()

    def restart(self) -> None:
        """Forget all values, and begin again with the first entry."""
        self.values.clear()
        self._asked = self._due = None
        self._open = set(self._once)
        self._turn = deque([*self._once, *self._again])

    @property
    def begun(self) -> bool:
        """Whether all entries of `once` have been answered."""
        return not self._open

    def take(self, now: float, frame: Frame) -> bool:
        """Handle any frame, also a request of another client; return whether it is an answer."""
        if frame.can_id == cia.SDO_RX_ID + self._node_id:
            self._next = now + YIELD_S
            if self._asked is not None and self._asked.in_segments:
                # The server has ended this transfer for that of the other client.
                self._done(self._asked.entry)
                self._due = None
            return False
        asked = self._asked
        if asked is None or not requests.answers(frame, asked.request):
            return False
        self.silent = False
        self._deadline = now + TIMEOUT_S
        try:
            if not asked.take(frame):
                self._due = asked.request
                return False
            self.values[asked.entry] = now, asked.raw
        except Abort:
            self.values.pop(asked.entry, None)
        self._done(asked.entry)
        self._next = max(self._next, now + PAUSE_S)
        return True

    def request(self, now: float) -> Frame | None:
        """Return the request that is due at a time in s, or None."""
        if self._asked is not None:
            if self._due is not None or now < self._deadline:
                due, self._due = self._due, None
                return due
            self.silent = True
            if self._asked.entry not in self._rarely:
                self._turn.appendleft(self._asked.entry)
            self._asked = None
            self._next = now + TIMEOUT_S
        if now < self._next or not self._turn:
            return None
        if self._rarely and self.begun and self._others >= _OFTEN:
            self._others = 0
            self._rarely.rotate(-1)
            entry = self._rarely[-1]
        else:
            self._others += 1
            entry = self._turn.popleft()
        self._asked = requests.Upload(self._node_id, entry)
        self._deadline = now + TIMEOUT_S
        return self._asked.request

    def _done(self, entry: Entry) -> None:
        self._asked = None
        if entry in self._open:
            self._open.discard(entry)
        elif entry not in self._rarely:
            self._turn.append(entry)


class LoadMeter:
    """Sums the durations of frames on the bus, each with the most stuff bits possible.

    Parameters
    ----------
    bit_rate
        Bit rate in bit/s, above 0.
    """

    def __init__(self, bit_rate: int) -> None:
        # An RTR frame is as long as a frame without data.
        self._seconds = [frame_seconds(size, bit_rate) for size in range(9)]
        self._frames: deque[tuple[float, float]] = deque()
        self._busy = 0.0

    def take(self, now: float, frame: Frame) -> None:
        """Count a frame that was on the bus at a time in s."""
        seconds = self._seconds[0 if frame.rtr else len(frame.data)]
        self._frames.append((now, seconds))
        self._busy += seconds

    def at(self, now: float) -> tuple[float, float]:
        """Return the busy fraction of the last second, and its number of frames."""
        while self._frames and self._frames[0][0] <= now - WINDOW_S:
            self._busy -= self._frames.popleft()[1]
        if not self._frames:
            self._busy = 0.0
        return self._busy / WINDOW_S, len(self._frames) / WINDOW_S


class Stop:
    """Writes controlword and mode repeatedly: a frame may be lost, and another client may arm.

    Parameters
    ----------
    od
        Object dictionary of the stimulator, loaded for its node-ID.

    Attributes
    ----------
    asked
        Whether a stop was requested, and the stimulator has not confirmed it yet.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._frames = [
            requests.download(od.node_id, od["Controlword"], 0),
            requests.download(od.node_id, od["Mode"], int(Mode.OFF)),
        ]
        self.asked = False
        self._first: float | None = None
        self._next = 0.0

    def ask(self) -> None:
        """Request a stop; another request extends it."""
        self.asked = True
        self._first = None

    def frames(
        self, now: float, shown: tuple[float, int] | None, rested: float | None
    ) -> list[Frame]:
        """Return the frames to send at a time in s.

        Parameters
        ----------
        now
            Present time in s.
        shown
            Time in s and value of the last statusword; None before the first.
        rested
            Time in s of the last heartbeat in another state than OPERATIONAL; None before the
            first.
        """
        if not self.asked:
            return []
        if self._first is None:
            self._first = self._next = now
        if _rests(self._first, shown, rested):
            self.asked = False
            return []
        if now < self._next:
            return []
        self._next = now + _STOP_AGAIN_S
        return list(self._frames)


def _rests(since: float, shown: tuple[float, int] | None, rested: float | None) -> bool:
    if rested is not None and rested > since:
        return True
    return shown is not None and shown[0] > since and known_state(shown[1]) not in _ARMED
