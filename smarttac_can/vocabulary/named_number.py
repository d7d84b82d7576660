"""A number of the object dictionary that shows as its name."""

from __future__ import annotations

from enum import IntEnum


class NamedNumber(IntEnum):
    """An IntEnum that a person who prints it can read: ``RUNNING`` and not ``3``."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        return format(self.name, spec)
