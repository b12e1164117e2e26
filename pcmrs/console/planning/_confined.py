"""Confinement of a process before it reads an untrusted file: memory, network, files and programs."""

from __future__ import annotations

import ctypes
import os
import platform
import resource
import signal
import struct
from typing import Final

_LOAD, _IS, _AT_LEAST, _RETURN = 0x20, 0x15, 0x35, 0x06
"""Instructions of the kernel's filters: load a word, jump if equal, jump if greater or equal, return."""
_NUMBER, _ARCHITECTURE = 0, 4
"""Offsets of the number of a system call, and of its architecture, in a filter's data."""
_ALLOW: Final = 0x7FFF0000
_REFUSE: Final = 0x00050001
"""The call returns EPERM."""
_NO_NEW_PRIVILEGES, _PARENT_DEATH = 38, 1
_SET_FILTER, _OF_ALL_THREADS = 1, 1
_OPEN_FILES: Final = 256

_CALLS: Final = {
    # The kernel's name of the architecture; seccomp; socket, execve, execveat, ptrace, process_vm_writev,
    # io_uring_setup (which opens sockets, too) and pidfd_getfd.
    "x86_64": (0xC000003E, 317, (41, 59, 322, 101, 311, 425, 438)),
    "aarch64": (0xC00000B7, 277, (198, 221, 281, 117, 271, 425, 438)),
}
_FROM_HERE_OTHERS: Final = 0x40000000
"""First number of the system calls of another convention (x32)."""


def confine(memory: int, seconds: int) -> None:
    """Give up everything that reading a file does not need. Threads that already run are confined, too.

    Afterwards this process cannot open a socket, start a program, write to a file or another process, or leave a core
    dump, which would hold a patient's data. It ends when its parent does.

    Args:
        memory: Limit of the address space, bytes.
        seconds: Limit of processor time, s.

    Raises:
        OSError: The kernel does not accept the limits.
        NotImplementedError: The system calls of this architecture are not known here.
    """
    for limit, value in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_NOFILE, _OPEN_FILES),
    ):
        _, most = resource.getrlimit(limit)
        value = value if most == resource.RLIM_INFINITY else min(value, most)
        resource.setrlimit(limit, (value, value))
    libc = ctypes.CDLL(None, use_errno=True)
    _check(libc.prctl(_PARENT_DEATH, signal.SIGKILL, 0, 0, 0))
    _check(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _filter_calls(libc)


def _filter_calls(libc: ctypes.CDLL) -> None:
    machine = platform.machine()
    if machine not in _CALLS:
        raise NotImplementedError(f"Files are read on {' and '.join(_CALLS)} only, not on {machine}.")
    architecture, seccomp, refused = _CALLS[machine]
    checks = [(_IS, number) for number in refused] + [(_AT_LEAST, _FROM_HERE_OTHERS)]
    steps = [(_LOAD, 0, 0, _ARCHITECTURE), (_IS, 0, len(checks) + 2, architecture), (_LOAD, 0, 0, _NUMBER)]
    # A jump counts the instructions that it skips: all later checks, and the one that allows.
    steps += [(code, len(checks) - place, 0, value) for place, (code, value) in enumerate(checks)]
    steps += [(_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _REFUSE)]
    program = b"".join(struct.pack("HBBI", *step) for step in steps)
    buffer = ctypes.create_string_buffer(program, len(program))
    described = struct.pack("HxxxxxxP", len(steps), ctypes.addressof(buffer))
    _check(libc.syscall(seccomp, _SET_FILTER, _OF_ALL_THREADS, ctypes.create_string_buffer(described, len(described))))


def _check(status: int) -> None:
    if status != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"The process cannot be confined: {os.strerror(number)}.")
