"""The chunks of a campaign on an existing Dask cluster; needs the extra ``dask``."""

from __future__ import annotations

from collections.abc import Generator
from importlib import import_module
from importlib.util import find_spec
from itertools import islice
from typing import Final

from smarttac_can.campaign.chunk import Rows, prepare, run_chunk
from smarttac_can.population.trial import Campaign

PATIENCE_S: Final = 10
"""Longest wait for a scheduler."""
_AHEAD: Final = 4
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

        first = [submit(chunk) for chunk in islice(waiting, _AHEAD * threads)]
        done = distributed.as_completed(first, loop=client.loop)
        for future in done:
            if future.status != "finished":
                raise ClusterError(f"a worker of the cluster failed: {future.exception()}")
            yield future.result()
            done.update([submit(chunk) for chunk in islice(waiting, 1)])
