"""The link without a bus: the two function blocks in this process, no CANopen between."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NoReturn

from smarttac_can.bench.errors import refused_write
from smarttac_can.bench.link import (
    PUBLISHED,
    RECORDED,
    FrameSource,
    Hear,
    OneRun,
    Row,
    Snapshot,
    never,
)
from smarttac_can.bench.published import published_pdos
from smarttac_can.device.frame import Frame
from smarttac_can.master.errors import BenchError, RefusedError
from smarttac_can.master.requests import download, downloaded, downloading
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.od.cia import Abort, AbortCode

_STATUS_TPDO: Final = 1


class LocalLink:
    """A stimulator with the plate inside, reached by function calls.

    Values are scaled to the integers of the object dictionary as on the bus, so a run gives the
    same numbers as one over CAN.

    Parameters
    ----------
    block
        Function block of a stimulator with the plate inside.
    """

    def __init__(self, block: StimulatorBlock) -> None:
        self._block = block
        self._recorded = [block.od[name].reader for name in RECORDED]
        self._pdos = published_pdos(block.od, lambda entry: int(entry.default))
        self._readers = [[block.od[name].reader for name in pdo.names] for pdo in self._pdos]
        self._hear: Hear | None = None
        self._alone = OneRun()
        self._status = b""

    @property
    def where(self) -> str:
        """Name of what it goes over, for messages."""
        return "the local link"

    @property
    def only_read(self) -> bool:
        """Always False: nobody else can reach a stimulator in this process."""
        return False

    def drive(self) -> None:
        """Do nothing: nobody else can drive a stimulator in this process."""

    def read(self, name: str) -> int:
        """Read the raw value of an object by name.

        Raises
        ------
        RefusedError
            If the object is write-only.
        """
        entry = self._block.od[name]
        if not entry.readable:
            reason = Abort(AbortCode.WRITE_ONLY)
            raise RefusedError(f"cannot read {name}: {reason}", reason.code)
        return int(entry.read())

    def text(self, name: str) -> str:
        """Read an object that is a string."""
        return str(self._block.od[name].read())

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object by name.

        Raises
        ------
        RefusedError
            If the object is read-only, or refuses the value in its present state.
        """
        entry = self._block.od[name]
        try:
            if not entry.writable:
                raise Abort(AbortCode.READ_ONLY)
            self._block.write(name, raw)
        except Abort as error:
            raise refused_write(entry, raw, error) from error
        node_id = self._block.od.node_id
        self._tell((download(node_id, entry, raw), downloaded(node_id, entry)))

    def read_table(self, name: str) -> bytes:
        """Read an object that is a DOMAIN."""
        return bytes(self._block.od[name].read())

    def write_table(self, name: str, data: bytes) -> None:
        """Write an object that is a DOMAIN.

        Raises
        ------
        RefusedError
            If the stimulator refuses it.
        """
        try:
            self._block.write(name, data)
        except Abort as error:
            raise RefusedError(f"cannot write {name}: {error}", error.code) from error
        self._tell(downloading(self._block.od.node_id, self._block.od[name], data))

    def snapshot(self) -> Snapshot:
        """Return the present values of the published objects; their age is 0 s."""
        return Snapshot({name: int(self._block.od[name].read()) for name in PUBLISHED}, 0.0)

    def start_run(self) -> None:
        """Put the simulated plate to rest at tick 0 and reset the controllers."""
        self.write("Simulation.Start run", 1)

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Let so many cycles pass, and append a row of recorded values for each.

        Raises
        ------
        BusyError
            While another thread runs the loop.
        """
        tick = self._block.tick
        recorded = self._recorded
        with self._alone:
            for _ in range(cycles):
                if interrupted():
                    return
                tick()
                rows.append(tuple([read() for read in recorded]))
                if self._hear is not None:
                    self._tell_cycle(self._hear)

    def source(self) -> FrameSource:
        """Tell what the PDOs of a stimulator with the default mapping would carry."""
        return FrameSource(
            published=self._pdos,
            every_cycle=[pdo.number for pdo in self._pdos if pdo.number != _STATUS_TPDO],
            commanded=[],
            plate=None,
            clocked=False,
        )

    @contextmanager
    def frames(self, hear: Hear) -> Iterator[None]:
        """Have the frames told that there would be with a bus."""
        self._hear = hear
        try:
            yield
        finally:
            self._hear = None

    def raw(self, path: Path) -> NoReturn:
        """Refuse: without a bus there is nothing to log."""
        raise BenchError(f"there is no bus whose frames could go to {path}: simulate('bus')")

    def wrong_time(self) -> str:
        """Return nothing: time passes in `run` alone."""
        return ""

    def close(self) -> None:
        """Do nothing: there is no bus to leave."""

    def _tell(self, frames: Iterable[Frame]) -> None:
        """Tell the frames of a write that there would be with a bus."""
        if self._hear is not None:
            for frame in frames:
                self._hear(frame.can_id, frame.data)

    def _tell_cycle(self, hear: Hear) -> None:
        """Tell the TPDOs of a cycle; the one with the status if it has changed."""
        for pdo, readers in zip(self._pdos, self._readers, strict=True):
            data = pdo.layout.pack(*[read() for read in readers])
            if pdo.number == _STATUS_TPDO:
                if data == self._status:
                    continue
                self._status = data
            hear(pdo.can_id, data)
