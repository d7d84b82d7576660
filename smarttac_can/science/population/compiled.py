"""The functions of the loop, compiled if numba is installed.

Numba does not compile a function that another one finds among its globals. So each function is
copied with globals in which the functions of this package that it calls are compiled ones. Plant
and controllers need not know of it. Arithmetic gives the same bits; exp, cos and pow may come from
another library and differ in the last bit.

Numba compiles functions of Python. In a build with mypyc they are read again from the sources,
which are beside the compiled modules.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.machinery import SourceFileLoader
from importlib.util import find_spec
from types import BuiltinFunctionType, CodeType, FunctionType
from typing import Any, TypeVar, cast

_PACKAGE = __name__.partition(".")[0] + "."
Function = TypeVar("Function", bound=Callable[..., Any])


def can_compile() -> bool:
    """Return whether numba is installed."""
    return find_spec("numba") is not None


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
    made: dict[Callable[..., Any], Any] = {}
    return cast(Function, _compiled(function, jit, made))


def _compiled(
    function: Callable[..., Any],
    jit: Callable[..., Any],
    made: dict[Callable[..., Any], Any],
) -> Any:
    if function not in made:
        plain, names = _plain(function)
        for name in plain.__code__.co_names:
            called: Any = names.get(name)
            ours = isinstance(called, FunctionType | BuiltinFunctionType)
            if ours and (called.__module__ or "").startswith(_PACKAGE):
                names[name] = _compiled(called, jit, made)
        made[function] = jit(FunctionType(plain.__code__, names, plain.__name__))
    return made[function]


def _plain(function: Callable[..., Any]) -> tuple[FunctionType, dict[str, Any]]:
    """Return a function as one of Python, and a copy of the names that it sees."""
    if isinstance(function, FunctionType):
        return function, dict(function.__globals__)
    names = vars(sys.modules[function.__module__])
    return _source(function.__module__)[function.__name__], dict(names)


@cache
def _source(module: str) -> dict[str, Any]:
    """Return the names of a module as its source makes them, whatever it was compiled to."""
    package, _, name = module.rpartition(".")
    path = f"{sys.modules[package].__path__[0]}/{name}.py"
    names: dict[str, Any] = {"__name__": module}
    exec(cast(CodeType, SourceFileLoader(module, path).get_code(module)), names)
    return names
