"""Progress of a long run, on stderr so that stdout stays for the results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import click

_STEPS: Final = 1000


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Show a bar while the block lasts; what it yields is called with the share done, 0..1.

    Off a terminal, where it would be a lone label, there is none.
    """
    if not sys.stderr.isatty():
        yield lambda _share: None
        return
    with click.progressbar(range(_STEPS), label=label, file=sys.stderr) as bar:
        yield lambda share: bar.update(round(share * _STEPS) - bar.pos)
