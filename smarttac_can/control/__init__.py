"""Controllers and tribometer of the stimulator, stepped once a millisecond."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.control.cascade import Cascade
    from smarttac_can.control.parameters import CascadeParameters

__all__ = ["Cascade", "CascadeParameters"]

__getattr__ = lazily(
    __name__,
    {
        "Cascade": "cascade",
        "CascadeParameters": "parameters",
    },
)
