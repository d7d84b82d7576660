"""A row of the fault matrix, and what rows look like to programs and readers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

from smarttac_can.od.object_reference import table
from smarttac_can.vocabulary.modes import Mode


@dataclass(frozen=True, slots=True)
class FaultRow:
    """What became of one fault in one mode."""

    fault: str
    mode: str
    voltage_before_v: float
    """Voltage of the power stage in the cycle before the fault."""
    detection_bound_cycles: int
    cycles_to_zero: int | None
    """Cycles from the fault to 0 V at the power stage; None if it was never reached."""
    emcy_codes: tuple[str, ...]
    """Codes of the emergency messages of both nodes until 50 cycles after the bound, each once."""
    state_after: str
    """State of the stimulator once the plate is at 0 V."""
    cycles_at_zero: int
    """Cycles at 0 V afterwards under traffic of the master."""
    held: bool
    """Whether these were as many as were asked for."""
    recovered: bool
    """Whether the run went on after cause and fault were cleared."""
    injected_at_s: float
    """Time stamp of the fault in the log."""
    reached_um: float
    """Largest vibration of the plate, from the fault until 0 V and 50 cycles."""

    covered: bool = True
    """Whether software can act; if not, the cycles to 0 V count from where it goes on."""

    @property
    def emcy_code(self) -> str | None:
        """Code of the first emergency message after the fault; None if there was none."""
        return self.emcy_codes[0] if self.emcy_codes else None

    @property
    def passed(self) -> bool:
        """Whether the fault ended in 0 V, in time if software can act, and for good until reset."""
        return (
            self.voltage_before_v > 0.0
            and self.cycles_to_zero is not None
            and (not self.covered or self.cycles_to_zero <= self.detection_bound_cycles + 1)
            and self.held
            and self.recovered
        )


def mode_name(mode: Mode) -> str:
    """Name of a mode as the bench takes it."""
    return mode.name.lower()


def rows_as_json(rows: Iterable[FaultRow]) -> list[dict[str, Any]]:
    """Return rows as JSON has them."""
    return [asdict(row) | {"emcy_code": row.emcy_code} for row in rows]


def matrix_table(rows: Iterable[FaultRow]) -> Iterator[str]:
    """Return the matrix as lines of Markdown."""
    return table(
        (
            "Fault",
            "Mode",
            "Before [V]",
            "Bound",
            "To 0 V",
            "Reached [um]",
            "EMCY",
            "State after",
            "Held",
            "Recovered",
        ),
        *(
            (
                row.fault,
                row.mode.replace("_", " "),
                f"{row.voltage_before_v:.0f}",
                str(row.detection_bound_cycles) if row.covered else "not covered",
                "never" if row.cycles_to_zero is None else str(row.cycles_to_zero),
                f"{row.reached_um:.2f}",
                ", ".join(row.emcy_codes) or "none",
                row.state_after.replace("_", " "),
                _yes(row.held),
                _yes(row.recovered),
            )
            for row in rows
        ),
    )


def _yes(it_is: bool) -> str:
    return "yes" if it_is else "no"
