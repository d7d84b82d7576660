"""Methods of a part as those of the whole, with their docstrings."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def of_part(
    part: str, method: Callable[Concatenate[Any, _Arguments], _Result]
) -> Callable[Concatenate[Any, _Arguments], _Result]:
    """Return a method that calls one of a part.

    Parameters
    ----------
    part
        Name of the attribute that holds the part.
    method
        Of the part's class.
    """

    @wraps(method)
    def called(whole: Any, /, *args: _Arguments.args, **kwargs: _Arguments.kwargs) -> _Result:
        return method(getattr(whole, part), *args, **kwargs)

    return called
