"""Work that goes on in a thread of its own while a block lasts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Self


class Background:
    """A context manager with a thread, which a process that ends does not wait for.

    Parameters
    ----------
    name
        Name of the thread.
    work
        What it does.
    end
        Called when the block ends, so that the work ends.
    patience
        Longest wait for that in s; None to wait for as long as it takes.
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

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._thread.join(self._patience)
