"""What is inside a node: every attribute of every object that it is made of."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from enum import Enum
from types import BuiltinFunctionType, FunctionType, GeneratorType, MethodType
from typing import Any, Final, NamedTuple

_OPAQUE: Final = (FunctionType, MethodType, BuiltinFunctionType, GeneratorType, type)
_APART: Final = ("Entry", "ObjectDictionary")
"""Classes whose objects are compared as the object dictionary."""
_PLAIN: Final = (int, float, complex, str, bytes, type(None), Enum, frozenset)
_ITEMS: Final = (list, tuple, set, frozenset, deque)


class Attribute(NamedTuple):
    """One attribute of one object."""

    owner: Any
    name: str

    @property
    def value(self) -> Any:
        return getattr(self.owner, self.name)

    @property
    def where(self) -> str:
        """Class and name: the same for all objects of a class."""
        return f"{type(self.owner).__name__}.{self.name}"


def attributes(node: Any) -> dict[str, Attribute]:
    """Return the attributes of a node and of all that it holds, by their paths."""
    found: dict[str, Attribute] = {}
    seen: set[int] = set()
    package = type(node).__module__.partition(".")[0] + "."
    waiting: deque[tuple[str, Any]] = deque([("node", node)])
    while waiting:
        path, thing = waiting.popleft()
        if id(thing) in seen or isinstance(thing, (*_PLAIN, *_OPAQUE)):
            continue
        seen.add(id(thing))
        if isinstance(thing, Mapping):
            waiting += [(f"{path}[{key}]", value) for key, value in thing.items()]
        elif isinstance(thing, _ITEMS):
            waiting += [(f"{path}[{place}]", value) for place, value in enumerate(thing)]
        elif type(thing).__module__.startswith(package) and type(thing).__name__ not in _APART:
            for name in _names(thing):
                value = getattr(thing, name)
                if not isinstance(value, _OPAQUE):
                    found[f"{path}.{name}"] = Attribute(thing, name)
                    waiting.append((f"{path}.{name}", value))
    return found


def _names(thing: Any) -> Iterator[str]:
    for base in type(thing).__mro__:
        slots = base.__dict__.get("__slots__", ())
        for name in (slots,) if isinstance(slots, str) else slots:
            if not name.startswith("__") and hasattr(thing, name):
                yield name
    yield from getattr(thing, "__dict__", {})


def still(value: Any) -> Any:
    """Return what a value is now, of which nothing changes later; objects by their identity."""
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, Mapping):
        return tuple([(still(key), still(item)) for key, item in value.items()])
    if isinstance(value, set):
        return frozenset(map(still, value))
    if isinstance(value, _ITEMS):
        return tuple(map(still, value))
    return type(value).__name__, id(value)


def another(value: Any) -> Any:  # noqa: PLR0911 - a line for each kind
    """Return a value of the same kind that is not the same; None where there is no such thing."""
    if isinstance(value, Enum):
        return next((other for other in type(value) if other is not value), None)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float | complex):
        return value + 1
    if isinstance(value, str):
        return value + "?"
    if isinstance(value, bytes):
        return value + b"?"
    if value is None:
        return 0
    if isinstance(value, Mapping):
        return {**value, 99: 99} if not value else dict(list(value.items())[1:])
    if isinstance(value, set | frozenset):
        return value ^ {99}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return _another_tuple(value)
    if isinstance(value, list | tuple | deque):
        changed = [another(value[0]), *list(value)[1:]] if value else [99]
        return None if changed[0] is None else type(value)(changed)
    return None


def _another_tuple(value: Any) -> Any:
    for name, item in zip(value._fields, value, strict=True):
        changed = another(item)
        if changed is not None:
            return value._replace(**{name: changed})
    return None
