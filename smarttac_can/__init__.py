"""SMARTTAC as a CANopen instrument: friction-modulation plate, nested controllers, two nodes."""

from pathlib import Path

__version__ = "0.1.0"


def build() -> str:
    """Return what runs in a cycle: ``compiled`` modules, or the ``sources``."""
    # A compiled module has the interpreter in its name, between two points.
    beside = Path(__file__).with_name("science").glob("plant/skin.*.*")
    return "compiled" if any(beside) else "sources"
