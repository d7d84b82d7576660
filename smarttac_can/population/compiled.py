"""The same functions, compiled by numba where it is installed.

Numba compiles no function that another one finds among its globals. So each is made anew with
globals in which the functions of this package that it calls are compiled ones; plant and
controllers know nothing of it. Arithmetic gives the same bits; exp, cos and pow may come from
another library and differ in the last one.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from types import FunctionType
from typing import Any, TypeVar, cast

from smarttac_can.plant.force_path import follow

_PACKAGE = __name__.partition(".")[0] + "."
Function = TypeVar("Function", bound=Callable[..., Any])


def can_compile() -> bool:
    """Whether numba is installed, and the formulas are as Python has them.

    In a build by mypyc they are not: numba would find no code in them.
    """
    return find_spec("numba") is not None and isinstance(follow, FunctionType)


def compiled(function: Function) -> Function:
    """Return a function of this package compiled, with all that it calls.

    It is compiled when it is first called, and releases the global lock: threads share the work.
    All that it calls is inlined: without that, copying the tuples of a step from function to
    function takes a third of the time.

    Raises
    ------
    ImportError
        Without numba.
    """
    jit = import_module("numba").njit(nogil=True, forceinline=True)
    made: dict[FunctionType, Any] = {}
    return cast(Function, _compiled(cast(FunctionType, function), jit, made))


def _compiled(
    function: FunctionType, jit: Callable[..., Any], made: dict[FunctionType, Any]
) -> Any:
    if function not in made:
        names = dict(function.__globals__)
        for name in function.__code__.co_names:
            called = names.get(name)
            if isinstance(called, FunctionType) and called.__module__.startswith(_PACKAGE):
                names[name] = _compiled(called, jit, made)
        made[function] = jit(FunctionType(function.__code__, names, function.__name__))
    return made[function]
