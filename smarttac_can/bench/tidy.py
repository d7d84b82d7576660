"""A trace as a table that other programs read: units in names, an empty cell for no value."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from smarttac_can import __version__
from smarttac_can.host.file_errors import in_words
from smarttac_can.master.errors import BenchError

if TYPE_CHECKING:
    import pandas

    from smarttac_can.bench.traces import Trace


class TidyColumn(NamedTuple):
    """A column of the table, made of one of the trace."""

    name: str
    of: str
    decimals: int
    empty_at_0: bool = False


TIDY: tuple[TidyColumn, ...] = (
    TidyColumn("time_s", "tick", 3),
    TidyColumn("cof", "mu", 4, empty_at_0=True),
    TidyColumn("cof_reference", "mu_ref", 4, empty_at_0=True),
    TidyColumn("amplitude_um", "W", 4),
    TidyColumn("voltage_v", "V", 2),
    TidyColumn("frequency_hz", "f", 2),
    TidyColumn("tangential_force_n", "Ft", 3),
    TidyColumn("normal_force_n", "Fn", 3),
    TidyColumn("position_mm", "position", 2),
    TidyColumn("statusword", "status", 0),
)


def to_dataframe(trace: Trace) -> pandas.DataFrame:
    """Return a row a tick; `attrs` has what holds for all.

    Raises
    ------
    BenchError
        If pandas is missing.
    """
    try:
        import pandas  # noqa: PLC0415 - slow, and not needed otherwise
    except ImportError as error:
        raise BenchError("a data frame needs pandas: pip install pandas") from error
    columns = {}
    for column, values in _columns(trace):
        numbers = values / 10**column.decimals if column.decimals else values
        columns[column.name] = numbers
        if column.empty_at_0:
            columns[column.name] = pandas.Series(numbers).where(values != 0)
    frame = pandas.DataFrame(columns)
    frame.attrs = metadata(trace)
    return frame


@in_words()
def write_tidy_csv(path: Path | str, trace: Trace) -> None:
    """Write lines of ``# key: value``, a header, and exact decimals or empty cells."""
    columns = _columns(trace)
    texts = [_cells(column, values.tolist()) for column, values in columns]
    with Path(path).open("w", encoding="ascii", newline="") as file:
        file.writelines(f"# {key}: {value}\n" for key, value in metadata(trace).items())
        file.write(",".join(column.name for column, _ in columns) + "\n")
        file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def metadata(trace: Trace) -> dict[str, Any]:
    """Return what holds for all rows of a trace."""
    return {
        "experiment": trace.experiment,
        "subject": trace.subject,
        "rows": len(trace),
        "lost_ticks": trace.lost,
        "made_by": f"smarttac-can {__version__}",
    }


def _columns(trace: Trace) -> list[tuple[TidyColumn, Any]]:
    """Return the columns that a trace has, with their integers."""
    found = [(column, getattr(trace, column.of)) for column in TIDY]
    return [(column, values) for column, values in found if values is not None]


def _cells(column: TidyColumn, values: list[int]) -> list[str]:
    return [
        "" if column.empty_at_0 and not value else f"{Decimal(value).scaleb(-column.decimals):f}"
        for value in values
    ]
