"""What the paper shows, done again: experiments, metrics, figures and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.paper.report import write_report

__all__ = ["write_report"]

__getattr__ = lazily(
    __name__,
    {
        "write_report": "report",
    },
)
