"""What a case of the suite is, and how it says that a device fails or that it does not apply."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from smarttac_can.conformance.description import DeviceDescription
    from smarttac_can.conformance.examiner import Examiner

Need = Callable[["DeviceDescription"], str | None]
"""Returns why a device of that data sheet cannot be asked, None if it can."""


class Failure(Exception):  # noqa: N818 - an outcome, not a mistake of the suite
    """The device breaks the rule; the message is one line."""


class NotApplicable(Exception):  # noqa: N818 - an outcome
    """The device shows that it does not have an optional feature; the message is one line."""


@dataclass(frozen=True, slots=True)
class Case:
    """One case.

    Attributes
    ----------
    number
        Its identifier, such as ``SDO-07``.
    title
        What is looked at.
    rule
        What a device must do, with the clause of CiA 301 (4.2), 302 or 306.
    needs
        What the data sheet must have for the case to apply.
    check
        Asks the device; raises `Failure` or `NotApplicable`.
    """

    number: str
    title: str
    rule: str
    needs: tuple[Need, ...]
    check: Callable[[Examiner], None]

    @property
    def group(self) -> str:
        """First part of the number."""
        return self.number.partition("-")[0]


def case(number: str, rule: str, *needs: Need) -> Callable[[Callable[[Examiner], None]], Case]:
    """Make a case of a function that asks the device; its docstring, a noun, is the title."""

    def made(check: Callable[[Examiner], None]) -> Case:
        return Case(number, (check.__doc__ or "").rstrip("."), rule, needs, check)

    return made


class Result(NamedTuple):
    """What came out of a case.

    Attributes
    ----------
    verdict
        ``pass``, ``fail`` or ``not applicable``.
    reason
        Empty for a pass.
    trace
        The last frames of a failed case, ``>`` to and ``<`` from the device.
    """

    case: Case
    verdict: str
    reason: str = ""
    trace: tuple[str, ...] = ()
