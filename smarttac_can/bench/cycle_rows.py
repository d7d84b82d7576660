"""A row of each cycle, made of the TPDOs that come one after another."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from queue import SimpleQueue
from typing import Final

from smarttac_can.bench.link import HELD, RECORDED, Row
from smarttac_can.bench.published import PublishedPdo
from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.device.nmt import NMTState

_TICK: Final = RECORDED.index("Contact.Tick")

Receiver = Callable[[int, bytearray, float], None]


class CycleRows:
    """Rows of `RECORDED` from the TPDOs of a stimulator.

    Parameters
    ----------
    device
        The stimulator.
    pdos
        Its public TPDOs by number.
    clock
        Returns the time in s.

    Attributes
    ----------
    rows
        Where the rows go; None for nowhere.
    complete
        Has something whenever a cycle is complete, with a row or without.
    whole
        Whether the TPDOs map all of `RECORDED`.
    wanted
        Numbers of the TPDOs that make a row; the others hold what changes seldom.
    """

    def __init__(
        self, device: RemoteDevice, pdos: list[PublishedPdo], clock: Callable[[], float]
    ) -> None:
        self._device = device
        self._clock = clock
        self.rows: list[Row] | None = None
        # At a tenth of what an event takes.
        self.complete: SimpleQueue[None] = SimpleQueue()
        self._come: set[int] = set()
        columns = [_place(pdos, name) for name in RECORDED]
        self._columns = [column for column in columns if column is not None]
        self.whole = len(self._columns) == len(RECORDED)
        self.wanted = {
            column[0].number
            for column, name in zip(columns, RECORDED, strict=True)
            if self.whole and column is not None and name not in HELD
        }

    def learn_held(self, read: Callable[[str], int]) -> None:
        """Read what is published when it changes, and did not come yet."""
        for pdo, _ in self._columns:
            if pdo.number not in self.wanted and pdo.received is None:
                pdo.values = tuple(read(name) for name in pdo.names)

    def receiver(self, pdo: PublishedPdo) -> Receiver:
        """Make the callback of a TPDO; that of the cycle's last one completes a row."""
        wanted, number = self.wanted, pdo.number
        parts, row_of = self._row_maker()
        completes = number == max(wanted, default=0)
        come, complete = self._come, self.complete
        clock, device = self._clock, self._device
        operational = NMTState.OPERATIONAL

        def on_pdo(_can_id: int, data: bytearray, _timestamp: float) -> None:
            if not pdo.take(data, clock()):
                return
            # PDOs are OPERATIONAL's alone; the next heartbeat may be a second away.
            device.state = operational
            come.add(number)
            if completes:
                # A row with a lost frame would mix two cycles.
                if come >= wanted and self.rows is not None:
                    values: list[int] = []
                    for part in parts:
                        values += part.values
                    _record(self.rows, row_of(values))
                come.clear()
                if complete.empty():
                    complete.put(None)

        return on_pdo

    def _row_maker(self) -> tuple[list[PublishedPdo], Callable[[list[int]], Row]]:
        """Return the TPDOs of a row, and what picks it from their values one after another."""
        columns = self._columns if self.whole else []
        parts = list(dict.fromkeys(pdo for pdo, _ in columns))
        places = [(pdo, at) for pdo in parts for at in range(len(pdo.names))]
        return parts, itemgetter(*map(places.index, columns)) if columns else tuple


def _record(rows: list[Row], row: Row) -> None:
    # When a cycle comes late, the event timers of the TPDOs repeat the one before.
    if not rows or row[_TICK] != rows[-1][_TICK]:
        rows.append(row)


def _place(pdos: list[PublishedPdo], name: str) -> tuple[PublishedPdo, int] | None:
    """Find the TPDO that carries an object, and its place there."""
    found = ((pdo, pdo.names.index(name)) for pdo in pdos if name in pdo.names)
    return next(found, None)
