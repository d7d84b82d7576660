"""A conformance suite for CANopen devices: 127 cases, judged by the frames on the bus alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.conformance.examiner import Examiner
    from smarttac_can.conformance.run import markdown, run_cases, summary

__all__ = ["Examiner", "markdown", "run_cases", "summary"]

__getattr__ = lazily(
    __name__,
    {
        "Examiner": "examiner",
        "markdown": "run",
        "summary": "run",
        "run_cases": "run",
    },
)
