"""A listener to a stimulator: frames and time go in, what there is to see comes out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Final

from smarttac_can.commissioning.scan import STATES
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.meanings import emergency_text, spoken
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import Status, known_state
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, watchdogs_in
from smarttac_can.watch.heard_node import HeardNode, gone, notes_of
from smarttac_can.watch.load_meter import LoadMeter
from smarttac_can.watch.published_values import PublishedValues, mapping_entries
from smarttac_can.watch.reader import SdoReader
from smarttac_can.watch.stop import Stop
from smarttac_can.watch.view import Emergency, Peer, View

READ: Final = (
    "Cycle.Cycles",
    "Diagnosis.Latched",
    "Setpoint.Voltage",
    "Setpoint.Amplitude",
    "Setpoint.COF left",
    "Setpoint.COF right",
    "Setpoint.Boundary",
    "Cycle.Lost cycles",
    "Cycle.Missed deadlines",
    "Cycle.Foreign ticks",
    "Cycle.Corrupt measurements",
    "Cycle.Surplus measurements",
)
"""What no TPDO carries by default, read by SDO in turn."""
FORGOTTEN_S: Final = 5.0
"""A value that SDO told is shown for so long."""
_EMERGENCIES: Final = 6
_HISTORY: Final = 120
_SAMPLE_S: Final = 0.25


class Watcher:
    """What can be told of a stimulator by listening, and by reading what no TPDO carries.

    It sends nothing but SDO reads of single objects, and nothing at all if `reads` is False; the
    one exception is `stop`.

    Parameters
    ----------
    stimulator
        EDS of the stimulator, loaded for its node-ID.
    plate
        EDS of the plate node, loaded for its node-ID; None with the plate inside the stimulator.
    bit_rate
        Of the bus in bit/s, for its load.
    reads
        Whether it may read by SDO.
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
        self._published = PublishedValues(stimulator)
        self._reader: SdoReader | None = None
        if reads:
            wanted = [stimulator[name] for name in READ]
            self._reader = SdoReader(stimulator.node_id, mapping_entries(stimulator), wanted)
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
        """Why there is no bus; empty while there is one."""

    def receive(self, now: float, frame: Frame) -> None:
        """Take a frame of another party, heard at a time in s."""
        self._load.take(now, frame)
        self._published.take(now, frame)
        for node in self._nodes:
            booted = node.take(now, frame)
            if booted and node is self._nodes[0] and self._reader is not None:
                # A reset has put the mapping back.
                self._reader.restart()
                self._remapped = False
            if frame.can_id == node.emergency_id and len(frame.data) > 1:
                code = int.from_bytes(frame.data[:2], "little")
                self._emergencies.appendleft((now, node.node_id, code))
        if self._reader is not None and self._reader.take(now, frame):
            self._follow(self._reader, now)

    def advance(self, now: float) -> list[Frame]:
        """Go on to a time in s; return the frames to send."""
        if self._began is None:
            self._began = now
            self._published.remap({}, now)
        if now >= self._next_sample:
            self._next_sample = now + _SAMPLE_S
            seen = self._published.at(now)
            self._history.append((self._cof(seen, "COF"), self._cof(seen, "COF reference")))
        shown = self._published.last("Statusword")
        frames = self._stop.frames(now, shown, self._nodes[0].rested)
        request = None if self._reader is None or self.lost else self._reader.request(now)
        if request is not None:
            frames.append(request)
        for frame in frames:
            self._load.take(now, frame)
        return frames

    def stop(self) -> None:
        """Have the stimulator disarmed: controlword and mode are written until it shows no drive.

        Any client may, whoever drives.
        """
        self._stop.ask()

    @property
    def stopping(self) -> bool:
        """Whether a stop was asked for, and the stimulator has not shown yet that it rests."""
        return self._stop.asked

    def view(self, now: float) -> View:
        """Return what there is to see at a time in s."""
        seen = self._published.at(now)
        touching = bool(seen.get("Statusword", 0) & Status.TOUCHING)
        load, rate = self._load.at(now)
        return View(
            peers=tuple(node.at(now) for node in self._nodes),
            notes=tuple(self._notes(now)),
            state=_state(seen),
            mode=_mode(seen),
            flags=tuple(spoken(flag) for flag in Status if seen.get("Statusword", 0) & flag),
            cof=self._cof(seen, "COF"),
            cof_reference=self._cof(seen, "COF reference"),
            tangential_n=self._value(seen, "Contact.Tangential force", "N"),
            normal_n=self._value(seen, "Contact.Normal force", "N"),
            amplitude_um=self._value(seen, "Vibration.Amplitude", "um"),
            voltage_v=self._value(seen, "Vibration.Voltage", "V"),
            frequency_hz=self._value(seen, "Vibration.Frequency", "Hz"),
            temperature_degc=self._value(seen, "Plate temperature", "degC"),
            position_mm=self._value(seen, "Contact.Position", "mm") if touching else None,
            read=self._told(now),
            cycle_rate=self._cycle_rate if "Cycle.Cycles" in self._told(now) else None,
            latched=self._latched(now),
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
            yield from notes_of(peer, now - (now if self._began is None else self._began))
        if not gone(peers[0]):
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

    def _value(self, seen: Mapping[str, int], name: str, unit: str) -> float | None:
        raw = seen.get(name)
        return None if raw is None else raw * self._od[name].unit.in_unit(unit)

    def _cof(self, seen: Mapping[str, int], what: str) -> float | None:
        """Return a COF; 0 stands for none."""
        return self._value(seen, f"Contact.{what}", "") or None

    def _raw_told(self, now: float) -> dict[str, int]:
        reader = self._reader
        if reader is None:
            return {}
        return {
            entry.name: reader.values[entry]
            for entry, at in reader.read_at.items()
            if entry in reader.values and now - at <= FORGOTTEN_S
        }

    def _told(self, now: float) -> dict[str, float]:
        raw = self._raw_told(now)
        return {
            name: raw[name] * self._od[name].unit.in_unit(self._od[name].unit.symbol)
            for name in READ
            if name in raw
        }

    def _latched(self, now: float) -> tuple[str, ...]:
        bits = self._raw_told(now).get("Diagnosis.Latched", 0)
        return tuple(WATCHDOGS[watchdog].text.partition(":")[0] for watchdog in watchdogs_in(bits))

    def _follow(self, reader: SdoReader, now: float) -> None:
        """Take over the mapping once it is known, and how fast cycles are counted."""
        if reader.begun and not self._remapped:
            self._remapped = True
            self._published.remap(reader.values, now)
        cycles = self._od["Cycle.Cycles"]
        at = reader.read_at.get(cycles)
        if at is None or cycles not in reader.values:
            self._cycles = None
            return
        if self._cycles is None or at > self._cycles[0]:
            count = reader.values[cycles]
            if self._cycles is not None and count >= self._cycles[1]:
                self._cycle_rate = (count - self._cycles[1]) / (at - self._cycles[0])
            self._cycles = at, count


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
