"""Debian packages that are fetched and not installed, for `with-vcan` and `with-browser`."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "smarttac-can"


def fetched(name: str, *packages: str) -> Path:
    """Return the folder in which packages, and their dependencies, are unpacked the first time.

    Raises
    ------
    OSError, subprocess.CalledProcessError
        If they cannot be fetched.
    """
    folder = CACHE / name
    if folder.is_dir():
        return folder
    CACHE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=CACHE) as scratch:
        # The host's package lists may be old or, in an image, not there at all.
        for needed in ("lists", "archives"):
            Path(scratch, needed, "partial").mkdir(parents=True)
        options = (f"Dir::State::Lists={scratch}/lists", f"Dir::Cache={scratch}")
        own = [word for text in (*options, "Debug::NoLocking=true") for word in ("-o", text)]
        install = ("install", "--yes", "--no-install-recommends", "--download-only", "--reinstall")
        for arguments in (("update",), (*install, *packages)):
            subprocess.run(
                ("apt-get", *own, *arguments), check=True, capture_output=True, text=True
            )
        unpacked = Path(scratch, "unpacked")
        for package in Path(scratch, "archives").glob("*.deb"):
            subprocess.run(("dpkg-deb", "-x", package, unpacked), check=True)
        if not folder.is_dir():  # another one may have been faster
            unpacked.rename(folder)
    return folder
