"""A number of the object dictionary that shows as its name."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

_OF_NUMBERS: Final = tuple("bcdnoxXeEfFgG%")


class NamedNumber(IntEnum):
    """An IntEnum that a person who prints it can read: ``RUNNING`` and not ``3``."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        """Format the name, or by ``d`` and the like the number."""
        return format(int(self) if spec.endswith(_OF_NUMBERS) else self.name, spec)
