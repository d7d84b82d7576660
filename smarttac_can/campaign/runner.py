"""A campaign from its first finger to its last: shared by workers, and kept on the way."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from time import perf_counter
from typing import Final, NamedTuple

import numpy as np

from smarttac_can.campaign.record import COLUMNS, Record, Rows, chunks_of, prepare, run_chunk
from smarttac_can.population.compiled import can_compile
from smarttac_can.population.trial import Campaign

PATIENCE_S: Final = 10
"""Longest wait for a scheduler."""
_AHEAD_OF_THREADS: Final = 4
"""Chunks for each thread of the cluster that are under way."""


class ClusterError(Exception):
    """A cluster that cannot be had, or that failed, in one line."""


def on_cluster(
    campaign: Campaign, chunks: list[range], address: str, compiled: bool
) -> Generator[tuple[range, Rows], None, None]:
    """Run chunks on a cluster; yield each when it is there.

    Parameters
    ----------
    campaign, chunks, compiled
        As for `run_chunk`.
    address
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    ClusterError
        If there is no such scheduler, it has no workers, or one of them failed.
    """
    if find_spec("distributed") is None:
        raise ClusterError("a cluster needs Dask: pip install 'smarttac-can[dask]'")
    distributed = import_module("distributed")
    try:
        # A client that takes the address for none leaves a complaint behind.
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
            if future.status != "finished":
                raise ClusterError(f"a worker of the cluster failed: {future.exception()}")
            yield future.result()
            done.update([submit(chunk) for chunk in islice(waiting, 1)])


_AHEAD: Final = 2
"""Chunks for each worker that are under way."""
Progress = Callable[[float], None]


class Result(NamedTuple):
    """What a campaign gave, and what it took."""

    rows: Rows
    """A row a finger, by their numbers; columns as in `COLUMNS`."""
    ran_s: float
    """Time in s that the fingers of this run have stroked."""
    wall_s: float
    """How long that took in s, without compiling."""
    compile_s: float
    compiled: bool | None
    """Whether compiled code has run the fingers; None if it was some of them."""


def run_campaign(
    campaign: Campaign,
    fingers: int,
    *,
    workers: int = 1,
    cluster: str | None = None,
    record: Record | None = None,
    progress: Progress | None = None,
) -> Result:
    """Run the fingers 0, 1, ... of a campaign; the rows do not depend on who does the work.

    Parameters
    ----------
    campaign
        What they have in common.
    fingers
        How many, 1 or more.
    workers
        Threads that share the work; compiled code lets them.
    cluster
        Address of a Dask scheduler whose workers do it instead.
    record
        What was run before, and where what is run now is kept.
    progress
        Called with the share that is done, 0..1.

    Raises
    ------
    ClusterError
        If the cluster cannot be had, or fails.
    """
    rows = np.full((fingers, len(COLUMNS)), np.nan)
    ways = set() if record is None else record.fill(rows)
    # A finger that ran has run for some time.
    missing = np.flatnonzero(np.isnan(rows[:, -1]))
    chunks, left, ran_s = chunks_of(missing), len(missing), 0.0
    compiled = can_compile()
    compile_s = prepare() if chunks and compiled and cluster is None else 0.0
    begin = perf_counter()
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
            if progress is not None:
                progress(1.0 - left / fingers)
    if chunks or not ways:
        ways.add(compiled)
    of_all = ways.pop() if len(ways) == 1 else None
    return Result(rows, ran_s, perf_counter() - begin, compile_s, of_all)


def _in_threads(
    campaign: Campaign, chunks: list[range], workers: int, compiled: bool
) -> Generator[tuple[range, Rows], None, None]:
    """Run chunks in threads; yield each when it is there, and begin no other one when closed."""
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
