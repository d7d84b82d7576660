"""What is compared is all there is: nothing that changes in a node goes unseen."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

import pytest
from frozen import NEW, old
from inside import Attribute, another, attributes, still
from pair import Side
from world import MASTER_ID, SAVE, Act, Seen, Setting, World

from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.textures import Axis, TextureTable

IN_TIME: Final = TextureTable(
    Axis.TIME, repeats=True, start=0, step=5000, values=(3000, 3500, 4000)
).pack()
SCRIPT: Final[list[Act]] = [
    ("put", "Gauge null.Window", 10), ("nmt", 0x01, 0), ("cycles", 70), ("mend", 1),
    ("begin", 2, 500, 1), ("recover", 4), ("cycles", 30),
    # Laws, limits and set-points in a run.
    ("put", "Friction law", 3), ("cycles", 20),
    ("put", "Controller.Vibration law", 2), ("cycles", 20),
    ("put", "Controller.Vibration law", 1), ("put", "Limit.Voltage", 9000),
    ("put", "Setpoint.Boundary", -2000), ("cycles", 20),
    ("put", "Limit.Amplitude trip", 300), ("cycles", 8), ("mend", 3), ("cycles", 30),
    ("put", "Limit.Highest frequency", 4_330_000), ("cycles", 4), ("put", "Controlword", 0),
    ("put", "Limit.Highest frequency", 4_400_000), ("mend", 3), ("cycles", 5),
    ("put", "Limit.Amplitude by drive", 100), ("cycles", 4), ("mend", 3), ("cycles", 5),
    ("put", "Mode", 2), ("cycles", 2), ("put", "Mode", 0), ("cycles", 2),
    ("put", "Controlword", 1), ("cycles", 2), ("put", "Controlword", 4), ("cycles", 2),
    ("put", "Controlword", 0),
    # What a run does not take.
    ("put", "Limit.Normal force", 3500), ("put", "Limit.Temperature", 5500),
    ("put", "Controller.Vibration law", 2), ("put", "Model.Tau", 9000), ("put", "Model.Load", 800),
    ("put", "Calibration.Fx from S1", 990), ("put", "Controller.Dead time", 100),
    ("put", "Calibration.Plate serial number", 7), ("put", "Texture.Slot", 2), ("cycles", 2),
    ("put", "Mode", 6), ("mend", 5), ("cycles", 5), ("mend", 4), ("cycles", 5),
    # Sensors, plate and stage.
    *(
        act
        for fault, mode, cycles in (
            ((4, 7, 800, 0), 3, 5), ((3, 3, 600, 0), 4, 20), ((2, 8, 1, 3), 3, 12),
            ((4, 7, 6000, 0), 1, 14), ((8, 1, -1500, 0), 3, 120), ((12, 1, 4000, 0), 1, 8),
            ((1, 9, 0, 0), 2, 20), ((11, 1, 9000, 0), 4, 9), ((10, 1, 7500, 0), 4, 4),
        )
        for act in (("fault", *fault), ("cycles", cycles), ("mend", mode), ("cycles", 5))
    ),
    # Frames.
    ("disturb", "LOSS", "measurement 2", 1), ("disturb", "DELAY", "drive", 2), ("cycles", 5),
    ("mend", 3), ("disturb", "CORRUPTION", "drive", 3), ("cycles", 12), ("mend", 3),
    ("pause", 32, 4), ("cycles", 6), ("mend", 6), ("cycles", 20),
    ("each_cycle", 0x320, "A00F48354200", 20), ("write", 32, 0x1401, 5, 5), ("cycles", 30),
    ("mend", 2), ("put", "Controlword", 0),
    ("connect_hardware", 1, 30), ("recover", 1), ("cycles", 12), ("mend", 2), ("cycles", 30),
    ("write", 32, 0x100C, 0, 50), ("write", 32, 0x100D, 0, 2), ("write", 32, 0x1017, 0, 0),
    ("frame", 0x720, "", True), ("cycles", 5), ("mend", 2),
    ("frame", 0x700 + MASTER_ID, "7F"), ("cycles", 3), ("frame", 0x700 + MASTER_ID, "00"),
    ("frame", 0x2A1, "00"), ("frame", 0x1A0, "00"), ("cycles", 3), ("put", "Controlword", 7),
    ("put", "Controlword", 3), ("put", "Controlword", 0), ("write", 32, 0x1006, 0, 2000),
    ("cycles", 2), ("mend", 3),
    ("clog", 32, 4), ("bus_off", 32, 5), ("cycles", 10),
    ("remap", 32, 2, ["Contact.COF", "Vibration.Voltage"], 9, True), ("mend", 3),
    # Storage and NMT.
    ("put", "Controlword", 0), ("put", "Tare at power-on", 1), ("put", "Texture.Slot", 1),
    ("write_long", 32, 0x2061, 2, ""), ("write_long", 32, 0x2061, 2, IN_TIME.hex()),
    ("put", "Texture.Slot", 2), ("recover", 6), ("cycles", 5), ("put", "Controlword", 0),
    ("store", 32, 1, SAVE), ("nmt", 0x80, 32), ("nmt", 0x02, 33), ("cycles", 3),
    ("nmt", 0x81, 32), ("cycles", 2), ("nmt", 0x01, 0),
    ("controlword", 1, 0), ("cycles", 70),
    ("put", "Simulation.Drive instant", 300), ("new_run", 3, 700, 0), ("power_cycle", 33),
    ("cycles", 3), ("anew", 3, 800, 0, 5), ("cycles", 420),
    # Time.
    ("mend", 1), ("stop_clock", 32, 9), ("syncs", 0, 12), ("cycles", 30), ("mend", 1),
    ("jump", 32, 4500), ("cycles", 3), ("mend", 1),
    *[("syncs", 0, 1), ("cycles", 45)] * 23,
    ("count_syncs",), ("cycles", 4), ("sync_counter", 3), ("cycles", 4), ("frame", 0x80, "0102"),
    ("mend", 3), ("syncs", 2, 12), ("cycles", 20),
    ("put", "AI auto-zero.AI auto-zero normal force", 1), ("heartbeat", False),
    ("wait", 1_200_000), ("write", 32, 0x1016, 1, 0), ("put", "Controlword", 1), ("cycles", 3),
]  # fmt: skip
"""What reaches as much as can be of both nodes."""
OF_HARDWARE: Final[list[Act]] = [
    ("begin", 2, 500, 1), ("recover", 1), ("cycles", 20),
    *(
        act
        for behaviour in ("fails", "nothing new", "slow", "not finite", "disobeys")
        for act in (("front_end", behaviour), ("cycles", 4), ("mend", 1), ("cycles", 5))
    ),
]  # fmt: skip
SCRIPTS: Final = (
    (Setting("node"), SCRIPT), (Setting("inside"), SCRIPT), (Setting("hardware"), OF_HARDWARE),
)  # fmt: skip
LOOKED_AT: Final = 60
"""Every how many cycles: a look at all of it takes longer than a cycle."""
UNSEEN: Final[dict[str, str]] = {
    "AnalogueInput._shown": "what stands in the object dictionary",
    "Cascade._predictive": "the same object as in the inner loops",
    "Cascade._from_off": "of no meaning while no mode is about to begin",
    "Clock.next_due": "made of the timers",
    "DriveBound._asked": "what `_response_asked` belongs to",
    "DriveBound._response_asked": "made of frequency, resonance and finger when it is asked for",
    "EmergencyConsumer.alive": "follows from the NMT state",
    "Emergency.alive": "follows from the NMT state",
    "ErrorBehaviour._state": "is the NMT state",
    "Guarding._state": "is the NMT state",
    "HeartbeatProducer._state": "is the NMT state",
    "Image.values": "what is stored",
    "LSS.alive": "follows from the NMT state",
    "ParameterStorage._loaded": "what is stored",
    "ParameterStorage.alive": "follows from the NMT state",
    "Port.listeners": "follows from NMT state and COB-IDs",
    "Plate._ambient": "in what the plate is made of",
    "Plate._dead_time": "in what the plate is made of",
    "SDOServer.alive": "follows from the NMT state",
    "Schedule._placed": "in the parameters",
    "Schedule._rows": "made when first asked for, of the model",
    "Sensors._rows": "made of seed and tick",
    "Setpoints._counts": "what stands in the object dictionary",
    "Setpoints._setpoint": "made of the object dictionary in each cycle",
    "Sync.alive": "follows from the NMT state",
    "InnerLoops.limited": "in what the cascade says",
    "InnerLoops._follows_load": "follows from the mode",
    "PI.Kp": "follows from mode, law and force",
    "PI.a": "follows from mode, law and force",
    "AmplitudeLoop.limited": "in what the cascade says",
    "Tribometer._gauges": "the newest sample",
    "TexturePlayer._by_position": "in the table that plays",
    "TimeStamp.alive": "follows from the NMT state",
}
"""What may change unseen, and why."""
CONSTANT: Final[dict[str, str]] = {
    "unfit": "only what another version has stored can contradict itself",
}
"""Names whose value the script does not change, and why."""


class Watched:
    """A node of the old implementation, and what has changed in it.

    Parameters
    ----------
    side
        The node with what is compared.

    Attributes
    ----------
    changed
        Paths of attributes that had different values.
    """

    def __init__(self, side: Side) -> None:
        self.side = side
        self.changed: set[str] = set()
        self._before: dict[str, Any] = {}

    def look(self) -> None:
        found = attributes(self.side.node)
        now = {path: still(attribute.value) for path, attribute in found.items()}
        before = self._before
        self.changed |= {path for path in now if path in before and before[path] != now[path]}
        self._before = now

    def see(self) -> str:
        """Return all that is compared of the node."""
        node, side = self.side.node, self.side
        seen = side.state(node), side.services(side.device), side.levels()
        return repr((seen, [entry.read() for entry in side.entries]))

    def unseen(self) -> set[str]:
        """Return which of the attributes that have changed may do so without being seen."""
        unseen = set()
        sound = self.see()
        for path, attribute in attributes(self.side.node).items():
            value = another(attribute.value) if path in self.changed else None
            if value is not None and not self._shows(attribute, value, sound):
                unseen.add(attribute.where)
        assert self.see() == sound
        return unseen

    def _shows(self, attribute: Attribute, value: Any, sound: str) -> bool:
        try:
            with other(attribute, value):
                return self.see() != sound
        except AttributeError:
            return True  # a frozen object, which is seen as a whole where it is held
        except (TypeError, ValueError, KeyError, IndexError, ArithmeticError):
            return True


@contextmanager
def other(attribute: Attribute, value: Any) -> Iterator[None]:
    """Give an attribute another value for now."""
    before = attribute.value
    setattr(attribute.owner, attribute.name, value)
    try:
        yield
    finally:
        setattr(attribute.owner, attribute.name, before)


class Names:
    """What is compared of the nodes of this tree, by name: whether it ever changes."""

    def __init__(self) -> None:
        self._first: dict[str, str] = {}
        self.changed: set[str] = set()

    def look(self, side: Side) -> None:
        for name, value in {**side.state(side.node), **side.services(side.device)}.items():
            text = repr(value)
            if self._first.setdefault(name, text) != text:
                self.changed.add(name)

    @property
    def constant(self) -> set[str]:
        return set(self._first) - self.changed


class Played(NamedTuple):
    """What came out of the scripts, over all settings."""

    unseen: set[str]
    names: Names
    seen: Seen


class LookedInto(World):
    """A world into whose nodes somebody looks: at the names in each cycle, at all now and then."""

    def __init__(self, setting: Setting, names: Names) -> None:
        super().__init__(old(), NEW, setting, all_every=LOOKED_AT)
        self._names = names
        self.watched = [Watched(pair.old) for pair in self.pairs.values()]

    def _look(self, *, all_of_it: bool = True) -> None:
        super()._look(all_of_it=all_of_it)
        for one, pair in zip(self.watched, self.pairs.values(), strict=True):
            self._names.look(pair.new)
            if all_of_it:
                one.look()


@pytest.fixture(scope="module")
def played() -> Played:
    """Both scripts, in all settings."""
    unseen: set[str] = set()
    names, seen = Names(), Seen()
    for setting, script in SCRIPTS:
        world = LookedInto(setting, names)
        world.play(script)
        for one in world.watched:
            assert len(one.changed) > 20
            unseen |= one.unseen()
        seen.add(world.seen)
    return Played(unseen, names, seen)


def test_what_changes_in_a_node_is_compared(played: Played) -> None:
    assert played.unseen == set(UNSEEN)


def test_what_is_compared_changes(played: Played) -> None:
    """A name that reads a constant in this tree would agree with nothing."""
    assert played.names.constant == set(CONSTANT)


def test_the_script_reaches_what_it_is_for(played: Played) -> None:
    assert set(played.seen.states) == {state.name for state in State}
    assert set(played.seen.driven) >= {mode.name for mode in Mode if mode}


def test_both_lists_have_the_same_names() -> None:
    for setting, _ in SCRIPTS:
        for pair in World(old(), NEW, setting).pairs.values():
            for before, now in ((pair.old, pair.new),):
                assert set(before.state(before.node)) == set(now.state(now.node))
