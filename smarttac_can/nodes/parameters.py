"""What the parameters of a stimulator mean to a cycle: plans, textures, model and gauge zeros."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.step import ControlPlan, control_plan
from smarttac_can.control.texture import NO_TEXTURE, Texture, texture_of
from smarttac_can.control.tribometer import Forces
from smarttac_can.nodes.supervisor import Supervisor
from smarttac_can.nodes.watches import WatchPlan, watch_plan
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.meanings import NOT_TARED, TARE, ZERO
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TARE_SAMPLES
from smarttac_can.vocabulary.states import LAWS, IdentificationState, Mode
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable

CALIBRATION: Final = "Calibration"
MODEL: Final = "Model"
LIMIT: Final = "Limit"
GAUGE_ZERO: Final = "Gauge zero"
NULL: Final = "Gauge null"
TEXTURE: Final = "Texture"
DESIGN: Final = ("Friction law", "Controller", LIMIT, CALIBRATION, TEXTURE)
"""Names of the records that hold the parameters of the cascade."""
_FIELDS: Final = {
    "Controller.Vibration law": "vibration_law",
    "Controller.Amplitude pole": "amplitude_pole",
    "Controller.Resonance pole": "resonance_pole",
    "Friction law": "law",
    "Controller.Friction slope per percent": "slope",
    "Controller.Friction step limit": "step_max",
    "Controller.Contact force": "contact_force",
    "Controller.Boundary hysteresis": "hysteresis",
    "Controller.Dead time": "dead_time",
    "Model.Data sheet gain per volt": "sheet_gain",
    "Model.Data sheet tau": "sheet_tau",
    "Model.Data sheet tolerance": "sheet_tolerance",
    "Texture.Preview": "preview",
    "Limit.Voltage": "V_max",
    "Limit.Amplitude": "W_max",
    "Limit.Lowest frequency": "f_min",
    "Limit.Highest frequency": "f_max",
}
"""Objects that are a parameter each; those of the calibration make up two together."""
_Quantity = Callable[[str], float]
"""Value of an object in SI units by its name."""


def mend_settings(od: ObjectDictionary) -> bool:
    """Put the parameters of the cascade back to their defaults if they contradict each other.

    Returns
    -------
    bool
        Whether they did.
    """
    try:
        cascade_parameters(od)
    except Abort:
        for entry in od:
            if entry.name.partition(".")[0] in DESIGN:
                entry.value = entry.default
        return True
    return False


UNTARED: Final[Forces] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Zero of the gauges before there is one."""


class Plans(NamedTuple):
    """What controllers and watchdogs go by."""

    parameters: CascadeParameters
    model: PlateModel
    control: ControlPlan
    watch: WatchPlan


class Present(NamedTuple):
    """What plans are built from beside the object dictionary."""

    model: PlateModel
    """In force; another one than it is not identified."""
    zero: Forces
    """In force, for a plate that was never tared."""
    texture: Texture
    """What is to play."""
    deadline_ms: int
    """Of the loop over the bus; 3 with the plate inside."""


def build_plans(
    od: ObjectDictionary, present: Present, written: Entry | None = None, raw: Any = 0
) -> Plans:
    """Build the plans as they are after a write.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    present
        All else.
    written, raw
        An entry with the raw value that it is about to take; None for the object dictionary as it
        is.

    Raises
    ------
    Abort
        VALUE if the parameters contradict each other.
    """
    name = "" if written is None else written.name

    def value(of: str) -> Any:
        return raw if of == name else od[of].value

    def si(of: str) -> float:
        return float(value(of) * od[of].si)

    parameters = _parameters(value, si)
    model = _model(si)
    zeros = [si(f"{GAUGE_ZERO}.Zero of S{number}") for number in range(1, 7)]
    s1, s2, s3, s4, s5, s6 = zeros if any(zeros) else present.zero
    identified = value("Model.State") == IdentificationState.DONE and model == present.model
    return Plans(
        parameters,
        model,
        control_plan(parameters, model, (s1, s2, s3, s4, s5, s6), present.texture),
        watch_plan(parameters, si, identified=identified, deadline_ms=present.deadline_ms),
    )


def cascade_parameters(od: ObjectDictionary) -> CascadeParameters:
    """Build the parameters of the cascade.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.

    Raises
    ------
    Abort
        VALUE if the parameters contradict each other.
    """
    return _parameters(lambda name: od[name].value, lambda name: od[name].si_value)


def _parameters(value: Callable[[str], Any], si: _Quantity) -> CascadeParameters:
    fields: dict[str, Any] = {
        field: LAWS[name](value(name)) if name in LAWS else si(name)
        for name, field in _FIELDS.items()
    }
    x3, x4, x5, x6 = [si(f"Calibration.Position of S{number}") for number in range(3, 7)]
    try:
        return CascadeParameters(
            **fields,
            lateral=(
                (si("Calibration.Fx from S1"), si("Calibration.Fx from S2")),
                (si("Calibration.Fy from S1"), si("Calibration.Fy from S2")),
            ),
            gauge_positions=(x3, x4, x5, x6),
        )
    except ValueError as error:
        raise Abort(AbortCode.VALUE, str(error)) from error


def plate_model(od: ObjectDictionary) -> PlateModel:
    """Build the model of the plate that the object dictionary holds."""
    return _model(lambda name: od[name].si_value)


def _model(si: _Quantity) -> PlateModel:
    return PlateModel(
        gain=si("Model.Gain per volt"),
        tau=si("Model.Tau"),
        f0=si("Model.Resonance"),
        load=si("Model.Load"),
        temperature=si("Model.Temperature"),
        softening=si("Model.Softening"),
    )


def keep_model(od: ObjectDictionary, model: PlateModel) -> None:
    """Write a model to the object dictionary, rounded as it stands there."""
    for name, value in (
        ("Gain per volt", model.gain),
        ("Tau", model.tau),
        ("Resonance", model.f0),
        ("Load", model.load),
        ("Temperature", model.temperature),
        ("Softening", model.softening),
    ):
        entry = od[f"Model.{name}"]
        entry.value = entry.quantise(value)


class TextureSlots:
    """Refuses tables that cannot be played before they replace what is there.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._entries = [od[name] for name in TABLE_NAMES]
        self._slot = od[f"{TEXTURE}.Slot"]
        self._mode = od["Mode"]
        bounds = od["Setpoint.COF left"]
        self._bounds = int(bounds.low), int(bounds.high)
        self._tables: dict[Entry, TextureTable | None] = dict.fromkeys(self._entries)

    def reload(self) -> None:
        """Take the values of the objects; one that cannot be played is emptied.

        It was stored by a version with other bounds: what is written is looked at before.
        """
        for entry in self._entries:
            try:
                self._tables[entry] = self._read(entry.value)
            except ValueError:
                self._tables[entry] = None
                entry.value = entry.default

    def chosen(self, written: Entry | None = None, raw: Any = None) -> Texture:
        """Return what is in the slot that is chosen, after a write if one is given.

        `NO_TEXTURE` if it is empty.
        """
        slot = raw if written is self._slot else self._slot.value
        table = self._tables[self._entries[slot - 1]]
        return NO_TEXTURE if table is None else texture_of(table)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Look at a write before it is made; what is accepted plays from the next cycle on.

        No bytes empty a slot.

        Raises
        ------
        Abort
            VALUE for what is no table that can be played, STATE for emptying the slot that is
            played, NO_DATA for playing an empty one; with the reason.
        """
        if entry in self._tables:
            self._take(entry, value)
        elif entry is self._mode and value == Mode.TEXTURE:
            self._require(self._slot.value)
        elif entry is self._slot and self._mode.value == Mode.TEXTURE:
            self._require(value)

    def _require(self, number: int) -> None:
        if self._tables[self._entries[number - 1]] is None:
            raise Abort(AbortCode.NO_DATA, f"texture slot {number} is empty")

    def _take(self, entry: Entry, data: bytes) -> None:
        try:
            table = self._read(data)
        except ValueError as error:
            raise Abort(AbortCode.VALUE, f"texture refused: {error}") from error
        chosen = entry is self._entries[self._slot.value - 1]
        if table is None and chosen and self._mode.value == Mode.TEXTURE:
            raise Abort(AbortCode.STATE, "texture is played: its slot cannot be emptied")
        self._tables[entry] = table

    def _read(self, data: bytes) -> TextureTable | None:
        if not data:
            return None
        table = TextureTable.unpack(data)
        table.require_within(*self._bounds)
        return table


class ModelSheet:
    """The record *Model* of the object dictionary: the model in force is the one read there.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._quality = od["Model.Quality"]
        self._state = od["Model.State"]
        self._progress = od["Model.Progress"]

    def follow(self, cascade: Cascade) -> bool:
        """Show how far an identification is, and keep its model at its end.

        Returns
        -------
        bool
            Whether the model is another one, or is believed for another reason.
        """
        identification = cascade.identification
        if identification is None:
            return False
        self._progress.value = int(100.0 * identification.progress)
        before, self._state.value = self._state.value, int(identification.state)
        if identification.model is None:
            return bool(self._state.value != before)
        keep_model(self._od, cascade.model)
        cascade.adopt(plate_model(self._od))
        self._show_quality(cascade.model)
        return True

    def show_written(self, model: PlateModel) -> None:
        """Show a model that was written: another one than before is not identified."""
        self._state.value = int(IdentificationState.IDLE)
        self._show_quality(model)

    def _show_quality(self, model: PlateModel) -> None:
        """Show how narrow the resonance is."""
        self._quality.value = self._quality.quantise(model.quality)


class NullWindow:
    """The null that each gauge had when it was calibrated, and how far it may have drifted.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._window = od[f"{NULL}.Window"]
        self._nulls = [od[f"{NULL}.Null of S{number}"] for number in range(1, 7)]

    def require(self, zeros: Forces) -> None:
        """Refuse zeros in N of which one is outside.

        Raises
        ------
        ValueError
            In one line with the gauge that is furthest off, its reading and the window.
        """
        off = [zero - null.si_value for zero, null in zip(zeros, self._nulls, strict=True)]
        worst = max(range(len(off)), key=lambda at: abs(off[at]))
        if abs(off[worst]) > self._window.si_value:
            raise ValueError(
                f"{NOT_TARED}S{worst + 1} reads {_mN(zeros[worst])}, more than "
                f"{_mN(self._window.si_value)} from its null of "
                f"{_mN(self._nulls[worst].si_value)}: lift what rests on the plate, and tare"
            )


def _mN(newton: float) -> str:
    return f"{newton * 1e3:.0f} mN"


class Taring:
    """Has the zeros in force be those that can be read, and stored.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    supervisor
        Inhibits a tare, and records a zero.
    """

    def __init__(self, od: ObjectDictionary, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._window = NullWindow(od)
        self._zeros = [od[f"{GAUGE_ZERO}.Zero of S{number}"] for number in range(1, 7)]
        self._at_power_on = od["Tare at power-on"]
        self._cycles = od["Cycle.Cycles"]

    def begin(self, cascade: Cascade) -> None:
        """Begin a run with the zeros of the objects; without any, the tare at power-on is due."""
        self._awaited = bool(self._at_power_on.value)
        self._from = TARE_SAMPLES
        self.restore(cascade)

    def restore(self, cascade: Cascade) -> None:
        """Put the zeros of the objects in force; all of them 0 stand for a plate never tared."""
        if any(entry.value for entry in self._zeros):
            self._put_in_force(cascade)

    def tare_when_due(self, cascade: Cascade) -> None:
        """Make the tare at power-on if it is awaited, and there are samples for it."""
        due = self._awaited and self._cycles.value >= self._from
        if due and not self._supervisor.tare_inhibited:
            try:
                self._tare(cascade)
            except ValueError as error:
                # The next samples may be without a finger.
                self._from += TARE_SAMPLES
                self._supervisor.refuse(TARE, str(error))

    def auto_zero(self, cascade: Cascade, signature: int) -> None:
        """Tare by command.

        Raises
        ------
        Abort
            VALUE for a wrong signature; STATE where a tare is barred, without enough samples, and
            with a null outside its window. With the reason.
        """
        if signature != ZERO:
            raise Abort(
                AbortCode.VALUE, f"{NOT_TARED}the value is not the signature {ZERO:08X}h, 'zero'"
            )
        if self._supervisor.tare_inhibited:
            raise Abort(
                AbortCode.STATE,
                f"{NOT_TARED}disarm first, and take away a force that has tripped a limit",
            )
        try:
            self._tare(cascade)
        except RuntimeError as error:
            raise Abort(AbortCode.STATE, f"{NOT_TARED}{error}") from error
        except ValueError as error:
            raise Abort(AbortCode.STATE, str(error)) from error

    def _tare(self, cascade: Cascade) -> None:
        zeros = cascade.null()
        self._window.require(zeros)
        for entry, zero in zip(self._zeros, zeros, strict=True):
            entry.value = entry.quantise(zero)
        self._put_in_force(cascade)

    def _put_in_force(self, cascade: Cascade) -> None:
        s1, s2, s3, s4, s5, s6 = [entry.si_value for entry in self._zeros]
        cascade.zero = (s1, s2, s3, s4, s5, s6)
        self._awaited = False
        self._supervisor.note_zero()
