"""Whether a data sheet is that of the device."""

from __future__ import annotations

from typing import Final

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import number
from smarttac_can.od.cia import IDENTITY, Abort

_TELLING: Final = {1: "vendor-ID", 2: "product code"}


def differences(examiner: Examiner) -> list[str]:
    """Name what the device says of its make and its data sheet says otherwise; empty if nothing.

    What the device does not tell or the sheet leaves open or at 0 is no difference.
    """
    od = examiner.sheet.od
    found = []
    for subindex, name in _TELLING.items():
        entry = od.get(IDENTITY, subindex)
        if entry is None or not entry.default:
            continue
        try:
            said = number(examiner, IDENTITY, subindex)
        except (Failure, Abort):
            continue
        if said != entry.default:
            found.append(f"{name} is {said:08X}h, not {entry.default:08X}h")
    return found
