"""Work in a separate thread during a block."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Self


class Background:
    """A context manager with a thread; a process that ends does not wait for the thread.

    Parameters
    ----------
    name
        Name of the thread.
    work
        Function that the thread runs.
    end
        Function called when the block ends, to end the work.
    patience
        Longest wait in s for the end of the work; None for no limit.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[], None],
        end: Callable[[], None],
        patience: float | None = None,
    ) -> None:
        self._thread = threading.Thread(target=work, name=name, daemon=True)
        self._end = end
        self._patience = patience

    @property
    def alive(self) -> bool:
        """Whether the work goes on; it does not if it has raised."""
        return self._thread.is_alive()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._thread.join(self._patience)
