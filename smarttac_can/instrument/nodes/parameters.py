"""Convert the parameters of a stimulator to plans, textures, the model and gauge zeros."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.supervisor import Supervisor
from smarttac_can.instrument.nodes.watches import WatchPlan, watch_plan
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.mode_shape import ModeShape
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.step import ControlPlan, control_plan
from smarttac_can.science.control.texture import NO_TEXTURE, Texture, texture_of
from smarttac_can.science.control.tribometer import Forces
from smarttac_can.vocabulary.meanings import NOT_TARED, TARE, ZERO
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import TARE_SAMPLES, null_window
from smarttac_can.vocabulary.states import LAWS, IdentificationState, Mode
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable

CALIBRATION: Final = "Calibration"
MODEL: Final = "Model"
LIMIT: Final = "Limit"
MODE_SHAPE: Final = "Mode shape"
GAUGE_ZERO: Final = "Gauge zero"
NULL: Final = "Gauge null"
TEXTURE: Final = "Texture"
DESIGN: Final = ("Friction law", "Controller", LIMIT, CALIBRATION, MODE_SHAPE, TEXTURE)
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
    "Calibration.COF uncertainty": "cof_uncertainty",
    "Calibration.COF uncertainty per K": "cof_uncertainty_shift",
    "Calibration.Null drift": "null_drift",
    "Calibration.Temperature": "calibration_temperature",
    "Mode shape.Node distance": "node_distance",
    "Mode shape.Cosine": "shape_cosine",
    "Mode shape.Sine": "shape_sine",
    "Texture.Preview": "preview",
    "Limit.Voltage": "V_max",
    "Limit.Amplitude": "W_max",
    "Limit.Lowest frequency": "f_min",
    "Limit.Highest frequency": "f_max",
}
"""Objects that are one parameter each. The matrix of the calibration is one parameter, and so are
its positions."""
_Quantity = Callable[[str], float]
"""Function that returns the value of an object in SI units by its name."""


def mend_settings(od: ObjectDictionary) -> bool:
    """Reset the parameters of the cascade to their defaults if they contradict each other.

    Returns
    -------
    bool
        Whether they contradicted each other.
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
"""Zero of the gauges before the first tare."""


class Plans(NamedTuple):
    """Plans of controllers and watchdogs, and what they are built from."""

    parameters: CascadeParameters
    model: PlateModel
    control: ControlPlan
    watch: WatchPlan


class Present(NamedTuple):
    """Present state from which plans are built, in addition to the object dictionary."""

    model: PlateModel
    """Model in force. A model that differs from it counts as not identified."""
    zero: Forces
    """Zero in force, used if the zeros in the object dictionary are all 0."""
    texture: Texture
    """Texture to play."""
    deadline_ms: int
    """Deadline of the loop over the bus in ms; 3 with the plate inside."""


def build_plans(
    od: ObjectDictionary, present: Present, written: Entry | None = None, raw: Any = 0
) -> Plans:
    """Build the plans as they are after a write.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    present
        Present state outside the object dictionary.
    written, raw
        Entry that is about to be written, and its raw value; None for the object dictionary as it
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
    """Build the parameters of the cascade from the object dictionary.

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
    """Build the model of the plate from the object dictionary."""
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
    """Write a model to the object dictionary, rounded to the resolution of its objects."""
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


def keep_mode_shape(od: ObjectDictionary, mode_shape: ModeShape) -> bool:
    """Write the known mode shape to the object dictionary; return whether that changes it."""
    entries = [od[f"{MODE_SHAPE}.{name}"] for name in ("Cosine", "Sine")]
    before = [entry.value for entry in entries]
    for entry, value in zip(entries, (mode_shape.c, mode_shape.s), strict=True):
        entry.value = entry.quantise(value)
    return [entry.value for entry in entries] != before


class TextureSlots:
    """Store the texture tables, and refuse tables that cannot be played.

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
        """Load the tables from the objects, and clear those that cannot be played.

        Only a version with other bounds can have stored such a table, as every write is checked.
        """
        for entry in self._entries:
            try:
                self._tables[entry] = self._read(entry.value)
            except ValueError:
                self._tables[entry] = None
                entry.value = entry.default

    def chosen(self, written: Entry | None = None, raw: Any = None) -> Texture:
        """Return the texture in the chosen slot, as it is after a write if one is given.

        An empty slot gives `NO_TEXTURE`.
        """
        slot = raw if written is self._slot else self._slot.value
        table = self._tables[self._entries[slot - 1]]
        return NO_TEXTURE if table is None else texture_of(table)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Check a write before it is made; an accepted table plays from the next cycle on.

        Writing no bytes clears a slot.

        Raises
        ------
        Abort
            VALUE for a table that cannot be played, STATE for clearing the slot that is being
            played, NO_DATA for playing an empty slot; with the reason.
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
    """The record *Model* of the object dictionary. It holds the model in force.

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
        """Show the progress of an identification, and store its model at the end.

        Returns
        -------
        bool
            Whether the model, or the state of its identification, has changed.
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
        """Show a model that was written and differs from the one before, as not identified."""
        self._state.value = int(IdentificationState.IDLE)
        self._show_quality(model)

    def _show_quality(self, model: PlateModel) -> None:
        self._quality.value = self._quality.quantise(model.quality)


class Taring:
    """Tare the gauges, and keep the zeros in force, in the objects and in storage the same.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    supervisor
        Supervisor that inhibits a tare, and that records a zero.
    """

    def __init__(self, od: ObjectDictionary, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._window = od[f"{NULL}.Window"]
        self._nulls = [od[f"{NULL}.Null of S{number}"] for number in range(1, 7)]
        self._zeros = [od[f"{GAUGE_ZERO}.Zero of S{number}"] for number in range(1, 7)]
        self._at_power_on = od["Tare at power-on"]
        self._cycles = od["Cycle.Cycles"]

    def begin(self, cascade: Cascade) -> None:
        """Start a run with the zeros of the objects; without any, tare at power-on if enabled."""
        self._awaited = bool(self._at_power_on.value)
        self._from = TARE_SAMPLES
        self.restore(cascade)

    def restore(self, cascade: Cascade) -> None:
        """Put the zeros of the objects in force, unless all are 0, as before the first tare."""
        if any(entry.value for entry in self._zeros):
            self._put_in_force(cascade)

    def tare_when_due(self, cascade: Cascade) -> None:
        """Tare at power-on as soon as this is due and there are enough samples."""
        due = self._awaited and self._cycles.value >= self._from
        if due and not self._supervisor.tare_inhibited:
            try:
                self._tare(cascade)
            except ValueError as error:
                # A finger may have touched; the next samples may be without it.
                self._from += TARE_SAMPLES
                self._supervisor.refuse(TARE, str(error))

    def auto_zero(self, cascade: Cascade, signature: int) -> None:
        """Tare by command.

        Raises
        ------
        Abort
            VALUE for a wrong signature. STATE if a tare is inhibited, if there are too few samples,
            or if a null is outside its window. With the reason.
        """
        if signature != ZERO:
            raise Abort(
                AbortCode.VALUE,
                f"{NOT_TARED}the value {signature:08X}h is not the signature {ZERO:08X}h, 'zero'",
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

    def require_near_null(self, zeros: Forces) -> None:
        """Check zeros in N against the nulls at calibration, from which they drift.

        Raises
        ------
        ValueError
            A zero is outside the window. One line names the gauge that is furthest off, its reading
            and the window.
        """
        nulls = [null.si_value for null in self._nulls]
        allowed = null_window(self._window.value, nulls) * 1e-3
        off = [zero - null for zero, null in zip(zeros, nulls, strict=True)]
        worst = max(range(len(off)), key=lambda at: abs(off[at]))
        if abs(off[worst]) > allowed:
            reads, window, null = (
                f"{newton * 1e3:.0f} mN" for newton in (zeros[worst], allowed, nulls[worst])
            )
            raise ValueError(
                f"{NOT_TARED}S{worst + 1} reads {reads}, more than {window} from its null of "
                f"{null}: lift what rests on the plate, and tare"
            )

    def _tare(self, cascade: Cascade) -> None:
        zeros = cascade.null()
        self.require_near_null(zeros)
        for entry, zero in zip(self._zeros, zeros, strict=True):
            entry.value = entry.quantise(zero)
        self._put_in_force(cascade)

    def _put_in_force(self, cascade: Cascade) -> None:
        s1, s2, s3, s4, s5, s6 = [entry.si_value for entry in self._zeros]
        cascade.zero = (s1, s2, s3, s4, s5, s6)
        self._awaited = False
        self._supervisor.note_zero()
