"""Requests of a process to the operating system for punctual cycles."""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import platform
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Final

_LOCK_NOW_AND_LATER: Final = 1 | 2
_WITHOUT_SLEEP_S: Final = 1.0
"""Processor time in s without a wait after which the kernel ends a real-time process. The runner
rests far more often, so such a process hangs."""
_KILLED_S: Final = 3.0
_COLLECT_S: Final = 1.0
_SLICE_NS: Final = 100_000
"""Shortest time slice that Linux accepts."""
_LATENCY_REQUEST: Final = Path("/dev/cpu_dma_latency")
_SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""Numbers of this system call, which Python does not offer."""


@contextmanager
def collecting_between_cycles() -> Iterator[Callable[[], None]]:
    """Run the garbage collection during the block only when its caller has time.

    Objects that exist at the beginning are never collected. Newer ones are collected only by the
    function that this yields.

    Yields
    ------
    Callable
        Function to call when there is time: it collects once a second.
    """
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    due = monotonic() + _COLLECT_S

    def collect() -> None:
        nonlocal due
        now = monotonic()
        if now >= due:
            due = now + _COLLECT_S
            gc.collect()

    try:
        yield collect
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()


def request_short_slices() -> None:
    """Request short time slices, so that the scheduler wakes this process without delay.

    It needs no privilege. Linux supports it from 6.12 on; elsewhere nothing happens.
    """
    number = _SCHED_SETATTR.get(platform.machine()) if sys.platform == "linux" else None
    if number is not None:
        attributes = _SchedulingAttributes(
            size=ctypes.sizeof(_SchedulingAttributes),
            policy=os.sched_getscheduler(0),
            nice=os.getpriority(os.PRIO_PROCESS, 0),
            runtime=_SLICE_NS,
        )
        ctypes.CDLL(None).syscall(number, 0, ctypes.byref(attributes), 0)


class _SchedulingAttributes(ctypes.Structure):
    """``struct sched_attr`` of sched_setattr(2), in its first size."""

    _fields_ = (
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    )


def request_real_time(priority: int, cpu: int | None) -> list[str]:
    """Request a real-time priority, locked memory and a fixed processor.

    Parameters
    ----------
    priority
        Priority of SCHED_FIFO, 1..99.
    cpu
        Number of the processor to run on; None for any.

    Returns
    -------
    list of str
        A line for each request that the system has refused, with the cure.

    Raises
    ------
    ValueError
        If there is no such processor, or this process may not use it.

    Notes
    -----
    The policy applies to the calling thread, not to threads that it starts later. A process at this
    priority that never waits would block its processor. So RLIMIT_RTTIME ends it with SIGXCPU after
    1 s, to be handled like SIGTERM, and with SIGKILL after 3 s.
    """
    if sys.platform != "linux":
        return [f"real time: {sys.platform} has no SCHED_FIFO for us, going on without"]
    refused = []
    if cpu is not None:
        try:
            os.sched_setaffinity(0, {cpu})
        except (OSError, OverflowError):
            allowed = ",".join(str(number) for number in sorted(os.sched_getaffinity(0)))
            raise ValueError(
                f"processor {cpu} is none of those that this process may use: {allowed}"
            ) from None
    try:
        # Threads started from here on, which serve the terminal, are ordinary.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError:
        refused.append(
            f"real time: SCHED_FIFO {priority} is refused, going on without: allow it by a line "
            f"'USER - rtprio {priority}' in /etc/security/limits.conf, or CAP_SYS_NICE"
        )
    else:
        _limit_time_without_sleep()
    refused += _lock_memory()
    return refused


def keep_processors_awake() -> list[str]:
    """Request that no processor sleeps from now on, as long as this process lives.

    A sleeping processor is woken late: by some us on bare metal, by more on a virtual machine,
    whose host gives an idle processor to others. The request costs power.

    Returns
    -------
    list of str
        At most one line: the request that the system has refused, with the cure.
    """
    if sys.platform != "linux":
        return []
    try:
        request = os.open(_LATENCY_REQUEST, os.O_WRONLY)
        try:
            os.write(request, struct.pack("=i", 0))
        except OSError:
            os.close(request)
            raise
        # The request lasts as long as the file is open; it is closed only with the process.
    except OSError as error:
        return [
            f"real time: processors that sleep are woken late, and {_LATENCY_REQUEST} is refused "
            f"({error.strerror}): let this user write it, by udev, or give it to the container"
        ]
    return []


def _limit_time_without_sleep() -> None:
    import resource  # noqa: PLC0415  # not on Windows

    _, most = resource.getrlimit(resource.RLIMIT_RTTIME)
    wanted = [int(seconds * 1e6) for seconds in (_WITHOUT_SLEEP_S, _KILLED_S)]
    if most != resource.RLIM_INFINITY:
        wanted = [min(limit, most) for limit in wanted]
    resource.setrlimit(resource.RLIMIT_RTTIME, (wanted[0], wanted[1]))


def _lock_memory() -> list[str]:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_LOCK_NOW_AND_LATER) == 0:
        return []
    reason = errno.errorcode.get(ctypes.get_errno(), "unknown")
    return [
        f"real time: locking the memory is refused ({reason}), going on without: allow it by a "
        "line 'USER - memlock unlimited' in /etc/security/limits.conf, or CAP_IPC_LOCK"
    ]
