"""Packages that only some need, asked for before the work that needs them begins."""

from __future__ import annotations

from importlib.util import find_spec

from smarttac_can.master.errors import BenchError


def require_matplotlib() -> None:
    """Raise BenchError, before a picture is drawn or read, if matplotlib is missing."""
    if find_spec("matplotlib") is None:
        raise BenchError("the pictures need matplotlib: pip install 'smarttac-can[report]'")
