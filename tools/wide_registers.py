"""Registers of a processor that user-mode-linux cannot save, and how tools/with-vcan hides them."""

from __future__ import annotations

import ctypes
import struct
from pathlib import Path

# The C library's own names, and those of numpy 2.4.
NARROW = {
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX_Fast_Unaligned_Load,-AVX_Usable,-AVX2_Usable,-AVX2,"
    "-AVX,-AVX512F,-AVX512VL,-AVX512BW,-ERMS,-BMI2,-SSE4_2",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3,X86_V4,AVX512_ICL,AVX512_SPR",
}
PR_SET_NO_NEW_PRIVS, PR_SET_SECCOMP, SECCOMP_MODE_FILTER = 38, 22, 2
LOAD, IF_EQUAL, RETURN = 0x20, 0x15, 0x06
PTRACE, PTRACE_GETREGSET, NT_X86_XSTATE = 101, 0x4204, 0x202
CALL, REQUEST, WHICH = 0, 16, 32
"""Where seccomp shows the number of the call, that of x86-64, and its first and third argument."""
EIO_INSTEAD, ALLOWED = 0x0005_0005, 0x7FFF_0000
STEPS = (
    (LOAD, 0, 0, CALL), (IF_EQUAL, 0, 5, PTRACE),
    (LOAD, 0, 0, REQUEST), (IF_EQUAL, 0, 3, PTRACE_GETREGSET),
    (LOAD, 0, 0, WHICH), (IF_EQUAL, 0, 1, NT_X86_XSTATE),
    (RETURN, 0, 0, EIO_INSTEAD), (RETURN, 0, 0, ALLOWED),
)  # fmt: skip


def wide_registers() -> bool:
    """Whether the processor has registers (AMX) that user-mode-linux cannot save."""
    return "amx_tile" in Path("/proc/cpuinfo").read_text(encoding="utf-8")


def hide_wide_registers() -> None:
    """Refuse this process, and what it starts, to read all registers of another by ptrace.

    user-mode-linux saves the short set then, without what `NARROW` keeps its programs from.
    """
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in STEPS))
    program = struct.pack("HxxxxxxP", len(STEPS), ctypes.addressof(code))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or libc.prctl(
        PR_SET_SECCOMP, SECCOMP_MODE_FILTER, program, 0, 0
    ):
        raise OSError(ctypes.get_errno(), "no seccomp filter")
