"""Run of a campaign: distribute fingers to workers, and store the results.

The results are stored in a file, so that an interrupted campaign can go on. The first line of JSON
identifies the campaign. A line for each finished chunk follows, with a checksum. Rows are written
so that reading restores every bit.
"""

from __future__ import annotations

import json
from collections.abc import Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from time import perf_counter
from typing import Any, BinaryIO, Final, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from smarttac_can import __version__
from smarttac_can.host.files import open_regular
from smarttac_can.science.population.compiled import can_compile
from smarttac_can.science.population.trial import (
    TOUCH_FIGURES,
    TOUCHES,
    Campaign,
    Figures,
    outcome_of,
)
from smarttac_can.studies.campaign.kept_loop import Progress, prepare

Rows = NDArray[np.float64]
"""A row per finger: true figures, measured figures, figures of single touches, time in s."""
CURVES: Final = (*Figures._fields, *(f"measured_{name}" for name in Figures._fields))
"""First columns: figures of the mean curves."""
COLUMNS: Final = (
    *CURVES,
    *(f"touch_{n}_{name}" for n in range(1, TOUCHES + 1) for name in TOUCH_FIGURES),
    "seconds",
)
SIZE: Final = 25
"""Fingers of a chunk when compiled: 0.25 s, so that a stop does not wait long; else it is one."""
_COMPILING: Final = 2000
"""Fingers that take about as long as compiling the loop, for the progress."""


def parameters(campaign: Campaign) -> dict[str, Any]:
    """Return the parameters that all fingers share, for JSON."""
    return {
        "seed": campaign.seed,
        "law": campaign.law.name.lower(),
        "vibration_law": campaign.vibration_law.name.lower(),
        "dead_time_us": campaign.dead_time * 1e6,
        "case": campaign.case,
        "plates": campaign.plates,
    }


def run_chunk(campaign: Campaign, numbers: range, compiled: bool) -> tuple[range, Rows]:
    """Run fingers by their numbers.

    Raises
    ------
    RuntimeError
        If this process can compile and the others cannot, or the other way round: the last bits
        would depend on the worker.
    """
    if can_compile() != compiled:
        raise RuntimeError(f"a worker {'lacks' if compiled else 'has'} numba, unlike this process")
    rows = []
    for number in numbers:
        (true, measured, touches), seconds = outcome_of(campaign, number)
        rows.append([*true, *measured, *touches.flat, seconds])
    return numbers, np.array(rows)


def chunks_of(missing: NDArray[np.intp], size: int) -> list[range]:
    """Divide increasing numbers of fingers into chunks of at most `size` consecutive ones."""
    chunks = []
    for stretch in np.split(missing, np.flatnonzero(np.diff(missing) != 1) + 1):
        if len(stretch):
            first, end = int(stretch[0]), int(stretch[-1]) + 1
            chunks += [range(n, min(n + size, end)) for n in range(first, end, size)]
    return chunks


_LINE_MAX: Final = 1 << 16
_FINGERS_MAX: Final = 1 << 32


class RecordError(Exception):
    """A file is damaged, or of another campaign; the message is one line."""


@dataclass(slots=True)
class _Chunk:
    first: int
    rows: Rows
    compiled: bool


class Record:
    """The file of one campaign, open for appending.

    Parameters
    ----------
    path
        Path of the file; created if it does not exist.
    campaign
        Campaign, which must be that of the file.

    Raises
    ------
    RecordError
        If the file is damaged or of another campaign. An unfinished last line is ignored.
    OSError
        If the file cannot be read or written.
    """

    def __init__(self, path: Path, campaign: Campaign) -> None:
        self._path = path
        self._chunks: list[_Chunk] = []
        header = _header(campaign)
        sound = self._read(header) if path.exists() else 0
        # For appending: the lines of two processes with one file do not overwrite each other.
        self._file: BinaryIO = path.open("ab")
        self._file.truncate(sound)
        if not sound:
            self._write(header)

    def __enter__(self) -> Record:
        """Return the record."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._file.close()

    def fill(self, rows: Rows) -> set[bool]:
        """Copy the stored results into the rows of all fingers; further ones are ignored.

        Returns
        -------
        set of bool
            Whether the fingers were run by compiled code; both values if only some were.
        """
        compiled = set()
        for chunk in self._chunks:
            here = rows[chunk.first : chunk.first + len(chunk.rows)]
            here[:] = chunk.rows[: len(here)]
            if len(here):
                compiled.add(chunk.compiled)
        self._chunks.clear()
        return compiled

    def add(self, numbers: range, rows: Rows) -> None:
        """Store a chunk that this process, or an equal one, has run."""
        crc = _crc(numbers.start, rows)
        chunk = {"first": numbers.start, "compiled": can_compile(), "rows": rows.tolist()}
        self._write({**chunk, "crc": crc})

    def _write(self, line: dict[str, Any]) -> None:
        self._file.write(_line(line))
        self._file.flush()

    def _read(self, header: dict[str, Any]) -> int:
        """Read all chunks; return the offset after the last complete line."""
        end = 0
        for number, line in enumerate(self._lines(), 1):
            if not line.endswith(b"\n") and len(line) < _LINE_MAX:
                # An unfinished first line must be the beginning of this header, not of another
                # file.
                if number == 1 and not _line(header).startswith(line):
                    raise RecordError(f"{self._path}: is no file of a campaign")
                break
            try:
                content = json.loads(line)
                if number > 1:
                    self._chunks.append(_chunk(content))
                elif not isinstance(content, dict) or "campaign" not in content:
                    raise ValueError
            except (ValueError, RecursionError) as error:
                raise RecordError(f"{self._path}: line {number} is damaged") from error
            if number == 1:
                self._require_same(content, header)
            end += len(line)
        return end

    def _lines(self) -> Iterator[bytes]:
        with open_regular(self._path) as file:
            while line := file.readline(_LINE_MAX):
                yield line

    def _require_same(self, content: dict[str, Any], header: dict[str, Any]) -> None:
        if not header.keys() <= content.keys():
            raise RecordError(f"{self._path}: is of another version: {content.get('campaign')!r}")
        for key, value in header.items():
            if (found := content.get(key)) != value:
                raise RecordError(
                    f"{self._path}: is of another campaign: {key} {found!r}, not {value!r}"
                )


def _line(content: dict[str, Any]) -> bytes:
    return json.dumps(content).encode() + b"\n"


def _header(campaign: Campaign) -> dict[str, Any]:
    """Return the parameters on which the rows depend.

    Compilation is not one of them: it changes at most the last bits. So a campaign can go on after
    numba was installed.
    """
    return {"campaign": __version__, **parameters(campaign)}


def _chunk(content: Any) -> _Chunk:
    """Return a chunk that was read; raise ValueError if it is invalid."""
    try:
        first, compiled, crc = content["first"], content["compiled"], content["crc"]
        rows = np.array(content["rows"], dtype=np.float64)
    except (KeyError, TypeError, OverflowError) as error:
        raise ValueError from error
    whole = isinstance(first, int) and 0 <= first < _FINGERS_MAX and rows.ndim == 2  # noqa: PLR2004
    if (
        not whole
        or not isinstance(compiled, bool)
        or rows.shape[1] != len(COLUMNS)
        or _crc(first, rows) != crc
    ):
        raise ValueError
    return _Chunk(first, rows, compiled)


def _crc(first: int, rows: Rows) -> int:
    return crc32(rows.astype("<f8").tobytes(), first)


PATIENCE_S: Final = 10
"""Longest wait for a scheduler in s."""
_AHEAD_OF_THREADS: Final = 4
"""Submitted chunks for each thread of the cluster."""


class ClusterError(Exception):
    """A cluster is not available, or has failed; the message is one line."""


def on_cluster(
    campaign: Campaign, chunks: list[range], address: str, compiled: bool
) -> Generator[tuple[range, Rows], None, None]:
    """Run chunks on a cluster; yield each when it is finished.

    Parameters
    ----------
    campaign, chunks, compiled
        As for `run_chunk`.
    address
        Address of the scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    ClusterError
        If there is no such scheduler, it has no workers, or one of them failed.
    """
    if find_spec("distributed") is None:
        raise ClusterError("a cluster needs Dask: pip install 'smarttac-can[dask]'")
    distributed = import_module("distributed")
    try:
        # Checked first, because a client with an invalid address leaves a complaint behind.
        distributed.comm.resolve_address(address)
        client = distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler at {address!r}: {error}") from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise ClusterError(f"the Dask scheduler at {address!r} has no workers")
        client.run(prepare)
        waiting = iter(chunks)

        def submit(chunk: range) -> object:
            return client.submit(run_chunk, campaign, chunk, compiled, pure=False)

        first = [submit(chunk) for chunk in islice(waiting, _AHEAD_OF_THREADS * threads)]
        done = distributed.as_completed(first, loop=client.loop)
        for future in done:
            # Of a worker that is killed before its result is fetched, another runs the chunk again.
            try:
                made = future.result()
            except Exception as error:
                raise ClusterError(f"a worker of the cluster failed: {error}") from error
            yield made
            done.update([submit(chunk) for chunk in islice(waiting, 1)])


_AHEAD: Final = 2
"""Submitted chunks for each worker."""


class Result(NamedTuple):
    """Rows of a campaign, and the time that they took."""

    rows: Rows
    """A row per finger, by number; columns as in `COLUMNS`."""
    ran_s: float
    """Simulated time in s of the fingers of this run."""
    wall_s: float
    """Real time in s for that, without compiling."""
    compile_s: float
    """Real time in s for compiling the loop, or loading it."""
    compiled: bool | None
    """Whether compiled code has run the fingers; None if it has run only some of them."""
    not_kept: str = ""
    """Why the next start compiles again, in one line; empty if it does not."""


def run_campaign(
    campaign: Campaign,
    fingers: int,
    *,
    workers: int = 1,
    cluster: str | None = None,
    record: Record | None = None,
    progress: Progress = lambda _share: None,
) -> Result:
    """Run the fingers 0, 1, ... of a campaign; the rows do not depend on the workers.

    Parameters
    ----------
    campaign
        Parameters that all fingers share.
    fingers
        Number of fingers, 1 or more.
    workers
        Number of threads; compiled code runs in parallel.
    cluster
        Address of a Dask scheduler whose workers run the fingers instead.
    record
        File with earlier results, to which the new ones are added.
    progress
        Function called with the fraction that is done, 0..1, also while the loop is compiled.

    Raises
    ------
    ClusterError
        If the cluster is not available, or fails.
    """
    rows = np.full((fingers, len(COLUMNS)), np.nan)
    ways = set() if record is None else record.fill(rows)
    # The time of a finger that has run is not NaN.
    missing = np.flatnonzero(np.isnan(rows[:, -1]))
    compiled = can_compile()
    chunks = chunks_of(missing, SIZE if compiled else 1)
    left, ran_s, ahead, not_kept = len(missing), 0.0, 0.0, ""

    def compiling(share: float) -> None:
        nonlocal ahead
        ahead = share * _COMPILING / (_COMPILING + left)
        progress(ahead)

    begin = perf_counter()
    if chunks and compiled and cluster is None:
        not_kept = prepare(compiling)
    compile_s, begin = perf_counter() - begin, perf_counter()
    results = (
        _in_threads(campaign, chunks, workers, compiled)
        if cluster is None
        else on_cluster(campaign, chunks, cluster, compiled)
    )
    with closing(results):
        for numbers, made in results:
            rows[numbers.start : numbers.stop] = made
            ran_s += float(made[:, -1].sum())
            left -= len(numbers)
            if record is not None:
                record.add(numbers, made)
            progress(1.0 - (1.0 - ahead) * left / fingers)
    if chunks or not ways:
        ways.add(compiled)
    of_all = ways.pop() if len(ways) == 1 else None
    return Result(rows, ran_s, perf_counter() - begin, compile_s, of_all, not_kept)


def _in_threads(
    campaign: Campaign, chunks: list[range], workers: int, compiled: bool
) -> Generator[tuple[range, Rows], None, None]:
    """Run chunks in threads; yield each when it is finished; when closed, start no other one."""
    with ThreadPoolExecutor(workers) as pool:
        waiting = iter(chunks)
        pending: set[Future[tuple[range, Rows]]] = set()
        try:
            while True:
                for chunk in islice(waiting, _AHEAD * workers - len(pending)):
                    pending.add(pool.submit(run_chunk, campaign, chunk, compiled))
                if not pending:
                    return
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
