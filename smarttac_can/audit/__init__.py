"""Results checked by somebody who did not make them: rows of the fault matrix against its log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.audit.fault_rows import DifferenceError, verify_rows

__all__ = ["DifferenceError", "verify_rows"]

__getattr__ = lazily(
    __name__,
    {
        "DifferenceError": "fault_rows",
        "verify_rows": "fault_rows",
    },
)
