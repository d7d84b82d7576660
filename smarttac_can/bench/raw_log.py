"""All frames of a bus in one of python-can's log formats, beside a recording."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import time

import can

from smarttac_can.bench.tapped_network import TappedNetwork
from smarttac_can.master.errors import BenchError


@contextmanager
def raw_log(network: TappedNetwork, path: Path) -> Iterator[None]:
    """Log what a network sends and receives while a block lasts.

    Parameters
    ----------
    network
        Connected, or on a local bus.
    path
        A file that does not exist yet: ASC, BLF, CSV, candump (``.log``), SQLite, TRC and so on by
        its suffix.

    Raises
    ------
    BenchError
        If it exists, cannot be written, or python-can has no such format; after the block, if not
        all of it could be written.
    """
    logger = _open(path)
    # python-can's notifier receives in one thread, and a bench sends in others.
    lock = threading.Lock()
    failures: list[Exception] = []

    def log(message: can.Message) -> None:
        with lock:
            # An error here would end the thread that hears the bus, or what the bench is sending.
            if not failures:
                try:
                    logger.on_message_received(message)
                except Exception as error:  # noqa: BLE001 (the formats raise what they like)
                    failures.append(error)

    def log_data(can_id: int, data: bytes) -> None:
        log(can.Message(time(), can_id, is_extended_id=False, data=data))

    receiving = network.notifier
    if receiving is None:
        network.taps += (log_data,)
    else:
        network.own_taps += (log_data,)
        receiving.add_listener(log)
    try:
        yield
    finally:
        network.taps = tuple(tap for tap in network.taps if tap is not log_data)
        network.own_taps = tuple(tap for tap in network.own_taps if tap is not log_data)
        if receiving is not None:
            receiving.remove_listener(log)
        with lock:
            try:
                logger.stop()
            except Exception as error:  # noqa: BLE001 (what it still held may not fit)
                failures.append(error)
    if failures:
        raise BenchError(f"{path} takes no more: {failures[0]}") from failures[0]


def _open(path: Path) -> can.Listener:
    if path.exists():
        raise BenchError(f"{path} exists: give the raw log another name")
    try:
        return can.Logger(path)
    except Exception as error:  # the formats raise what they like
        with suppress(OSError):
            if not path.stat().st_size:
                path.unlink()
        raise BenchError(f"cannot log to {path}: {error}") from error
