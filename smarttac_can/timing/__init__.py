"""How punctual the loop is on the wall clock, measured from the bus and at the stage."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.timing.loop_run import measure_loop

__all__ = ["measure_loop"]

__getattr__ = lazily(
    __name__,
    {
        "measure_loop": "loop_run",
    },
)
