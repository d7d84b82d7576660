"""Ctrl-C at one instruction of some modules, as it may come at any."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, ModuleType
from typing import Any


@contextmanager
def interrupted(instruction: int, *modules: ModuleType) -> Iterator[None]:
    """Raise KeyboardInterrupt in a block at this instruction, counted from 0, of these modules."""
    files, left, before = {module.__file__ for module in modules}, instruction, sys.gettrace()

    def trace(frame: FrameType, event: str, _: object) -> Callable[..., Any]:
        nonlocal left
        frame.f_trace_opcodes = frame.f_code.co_filename in files
        if event == "opcode":
            left -= 1
            if left < 0:
                sys.settrace(None)
                raise KeyboardInterrupt
        return trace

    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)
