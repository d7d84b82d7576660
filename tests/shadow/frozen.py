"""The package as it was, under another name, beside the one of this tree.

What a commit holds is written once to ``build/shadow``, with the name of the package changed in
every file, and is imported from there: a traceback shows its lines.
"""

from __future__ import annotations

import importlib
import io
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[2]
NAME: Final = "smarttac_can"
OLD_NAME: Final = "smarttac_can_old"
BASELINE: Final = "75b0661"
"""Commit of the old implementation, which the decision "before the cycle" names."""
_ARCHIVE: Final = Path(__file__).parent / "before_the_cycle.tar.xz"
"""What that commit holds: a clone without history has it as well."""
_PLACE: Final = ROOT / "build" / "shadow"
_KEPT_S: Final = 86400.0
"""How long a copy is kept that is not used, if another one is written."""
_FOLDERS: Final = (NAME, "eds")
_WORD: Final = re.compile(rf"\b{NAME}\b")
_WORD_BYTES: Final = re.compile(_WORD.pattern.encode())


class Package(NamedTuple):
    """One of the two implementations."""

    name: str

    def module(self, path: str) -> ModuleType:
        """Import a module, by its path below the package."""
        return importlib.import_module(f"{self.name}.{path}")


_chosen: list[str | None] = []
"""The one commit of this process, once it is known."""
NEW: Final = Package(NAME)
"""The implementation of this tree."""


def old(commit: str | None = BASELINE) -> Package:
    """Return the old implementation, of which there is one in a process.

    Parameters
    ----------
    commit
        What git calls it; None for this tree as it is. Its EDS files are those of this tree.

    Raises
    ------
    ValueError
        If git does not know the commit.
    RuntimeError
        If it is another one in this process.
    """
    if not _chosen:
        files = _of_tree(_FOLDERS) if commit is None else _of_commit(commit)
        # The implementations are compared, not their EDS files (decision 0071).
        files |= _of_tree(("eds",))
        sys.path.append(str(_written(files)))
        _chosen.append(commit)
    if _chosen != [commit]:
        raise RuntimeError(f"{OLD_NAME} is of {_chosen[0] or 'this tree'}, not of {commit}")
    return Package(OLD_NAME)


def _of_tree(folders: tuple[str, ...]) -> dict[str, bytes]:
    found = {}
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".eds"):
                found[path.relative_to(ROOT).as_posix()] = path.read_bytes()
    return found


def _of_commit(commit: str) -> dict[str, bytes]:
    if commit == BASELINE:
        data = _ARCHIVE.read_bytes()
    else:
        command = ["git", "-C", str(ROOT), "archive", "--format=tar", commit, *_FOLDERS]
        done = subprocess.run(command, check=False, capture_output=True)
        if done.returncode:
            raise ValueError(f"{commit}: {done.stderr.decode().strip()}")
        data = done.stdout
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        return {
            member.name: content.read()
            for member in archive
            if (content := archive.extractfile(member)) is not None
        }


def _written(files: dict[str, bytes]) -> Path:
    """Write files under the other name, unless they are there; return the folder."""
    digest = sha256()
    for name, content in sorted(files.items()):
        digest.update(name.encode() + b"\0" + content + b"\0")
    target = _PLACE / digest.hexdigest()[:16]
    if target.is_dir():
        target.touch()
        return target
    _PLACE.mkdir(parents=True, exist_ok=True)
    for unused in _PLACE.iterdir():
        if unused.stat().st_mtime < time.time() - _KEPT_S:
            shutil.rmtree(unused, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=_PLACE) as folder:
        half_done = Path(folder) / "half done"
        for name, content in files.items():
            path = half_done / _WORD.sub(OLD_NAME, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            renamed = path.suffix == ".py"
            path.write_bytes(_WORD_BYTES.sub(OLD_NAME.encode(), content) if renamed else content)
        try:
            half_done.rename(target)
        except OSError:
            # Another process was faster.
            if not target.is_dir():
                raise
    return target
