"""The compiled loop, kept on disk by numba's cache so that only the first start compiles.

numba compares the file of the outermost function alone, but compiles into it all functions that it
calls. So the folder of the cache is named by a hash of all sources that the loop can see, and of
what else its machine code depends on. The rest is done by numba's cache: it writes whole files and
then renames them, and two processes that compile at once write the same, because the loop has a
single signature.

A cache that fails never stops a campaign: the loop is then compiled without it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from shutil import rmtree
from threading import Lock
from typing import Any, Final

import smarttac_can
from smarttac_can.science.population.trial import Campaign, fastest, outcome_of

Progress = Callable[[float], None]
_ROOMS: Final = ("science", "vocabulary", "canopen")
"""Packages whose sources the loop can see; the layers of the package keep all others away."""
_KEPT: Final = 4
"""Most folders that are kept: for some versions of this package, of Python and of numba."""
_STEPS: Final = 150
"""Compiled functions, some 125, and as many as the optimiser takes in time at the end."""
_preparing = Lock()


def prepare(progress: Progress = lambda _share: None) -> str:
    """Load the compiled loop, or compile and keep it, once per process.

    Parameters
    ----------
    progress
        Function called with the fraction that is done, 0..1, while the loop is compiled.

    Returns
    -------
    str
        One line that says why the next start compiles again; empty if it does not.
    """
    with _preparing:
        loop: Any = fastest()[0]
        if getattr(loop, "signatures", True):  # it is ready, or is not to be compiled
            return ""
        with _reporting(progress):
            return _first_run(loop)


def _first_run(loop: Any) -> str:
    """Run a finger, for which numba loads or compiles the loop."""
    folder = None
    try:
        folder = _folder()
        _keep(loop, folder)
        outcome_of(Campaign(), 0)
    # A damaged file raises whatever its bytes suggest. An error of the loop itself comes again.
    except Exception as error:  # noqa: BLE001
        if folder is not None:
            rmtree(folder, ignore_errors=True)
        if not loop.signatures:
            fastest.cache_clear()
        outcome_of(Campaign(), 0)
        where, why = f" in {folder}" if folder else "", str(error) or type(error).__name__
        return (
            f"the compiled loop was not kept{where} ({why}), and the next start compiles again: "
            "NUMBA_CACHE_DIR names another folder"
        )
    _remove_old(folder)
    return ""


def _folder() -> Path:
    """Return the folder for these sources on this machine; raise OSError without sources."""
    package = Path(smarttac_can.__file__).parent
    sources = sorted(path for room in _ROOMS for path in (package / room).rglob("*.py"))
    if not sources:
        raise FileNotFoundError(f"{package} has no sources")
    llvm = import_module("llvmlite.binding")
    versions = [sys.version, *(import_module(name).__version__ for name in ("numba", "llvmlite"))]
    machine = [llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()]
    # With the path, because numba makes a folder below for each path of the sources.
    seen = sha256(repr([*versions, *machine, str(package)]).encode())
    for path in sources:
        seen.update(repr((str(path.relative_to(package)), path.read_bytes())).encode())
    variables = (os.environ.get(name) for name in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME"))
    caches = Path(next(filter(None, variables), None) or Path.home() / ".cache")
    return caches / "smarttac-can" / "numba" / seen.hexdigest()[:32]


def _keep(loop: Any, folder: Path) -> None:
    """Have numba load a function from this folder and keep it there; raise OSError if it cannot."""
    folder.mkdir(parents=True, exist_ok=True)
    config = import_module("numba").config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(folder)
    try:
        loop.enable_caching()
    finally:
        config.CACHE_DIR = before
    # Where it cannot write, numba takes a folder that knows nothing of the hash.
    if not Path(loop.stats.cache_path).is_relative_to(folder):
        raise PermissionError("numba cannot write there")


def _remove_old(folder: Path) -> None:
    """Remove the folders that have not been used for longest; this one has been used now."""
    with suppress(OSError):
        os.utime(folder)
        others = [path for path in folder.parent.iterdir() if path != folder]
        others.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        for old in others[_KEPT - 1 :]:
            rmtree(old, ignore_errors=True)


def _reporting(progress: Progress) -> AbstractContextManager[Any]:
    """Report the progress of what numba compiles during the block."""
    event = import_module("numba.core.event")
    done = 0

    def count(_: object) -> None:
        nonlocal done
        done += 1
        progress(min(done / _STEPS, 1.0))

    listener = event.RecordingListener()
    listener.on_end = count
    made: AbstractContextManager[Any] = event.install_listener("numba:compile", listener)
    return made
