"""The functions of the loop, compiled if numba is installed.

Numba does not compile a function that another one finds among its globals. So each function is
copied with globals in which the functions of this package that it calls are compiled ones. Plant
and controllers need not know of it. Arithmetic gives the same bits; exp, cos and pow may come from
another library and differ in the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from types import FunctionType
from typing import Any, TypeVar, cast

from smarttac_can.science.plant.force_path import follow

_PACKAGE = __name__.partition(".")[0] + "."
Function = TypeVar("Function", bound=Callable[..., Any])


def can_compile() -> bool:
    """Return whether numba is installed, and the formulas are functions of Python.

    In a build with mypyc they are not, and numba would find no code in them.
    """
    return find_spec("numba") is not None and isinstance(follow, FunctionType)


def compiled(function: Function) -> Function:
    """Return a compiled copy of a function of this package, with all functions that it calls.

    It is compiled at the first call, and releases the global lock, so that threads run in parallel.
    All called functions are inlined: otherwise copying the tuples of a step between functions takes
    a third of the time.

    Raises
    ------
    ImportError
        If numba is missing.
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
