"""Confinement of a process before it reads an untrusted file, by two layers of the kernel.

A filter (seccomp) lets only the listed system calls through, for all threads. Landlock, if the kernel has it, refuses
all changes of files, connections, and signals to other processes a second time, and looking into other processes, for
the thread that reads.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import platform
import resource
import signal
import struct
from collections.abc import Iterator
from typing import Final

_LOAD, _IS, _AT_LEAST, _HAS_ANY, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
"""Instructions of a filter: load a word; compare it: equal, not less, has one of the bits; return."""
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16
"""Offsets in a filter's data: number of a system call, its architecture, and its arguments, 8 bytes each."""
_ALLOW: Final = 0x7FFF0000
_REFUSE: Final = 0x00050000 | errno.EPERM
_NOT_THERE: Final = 0x00050000 | errno.ENOSYS
_NO_NEW_PRIVILEGES, _PARENT_DEATH = 38, 1
_SET_FILTER, _OF_ALL_THREADS = 1, 1
_OPEN_FILES: Final = 256

_ARCHITECTURES: Final = {"x86_64": 0xC000003E, "aarch64": 0xC00000B7}
"""The kernel's names of the architectures whose system calls are known here."""
_SECCOMP: Final = (317, 277)
_CALLS: Final[dict[str, tuple[int | None, int | None]]] = {
    # memory
    "brk": (12, 214),
    "madvise": (28, 233),
    "mmap": (9, 222),
    "mprotect": (10, 226),
    "mremap": (25, 216),
    "munmap": (11, 215),
    # reading, and writing to what was opened before
    "close": (3, 57),
    "dup": (32, 23),
    "lseek": (8, 62),
    "pread64": (17, 67),
    "read": (0, 63),
    "readv": (19, 65),
    "write": (1, 64),
    "writev": (20, 66),
    # looking for files
    "access": (21, None),
    "faccessat": (269, 48),
    "faccessat2": (439, 439),
    "fstat": (5, 80),
    "getcwd": (79, 17),
    "getdents64": (217, 61),
    "lstat": (6, None),
    "newfstatat": (262, 79),
    "readlink": (89, None),
    "readlinkat": (267, 78),
    "stat": (4, None),
    "statx": (332, 291),
    # time, and waiting
    "clock_getres": (229, 114),
    "clock_gettime": (228, 113),
    "clock_nanosleep": (230, 115),
    "futex": (202, 98),
    "gettimeofday": (96, 169),
    "nanosleep": (35, 101),
    "poll": (7, None),
    "ppoll": (271, 73),
    "pselect6": (270, 72),
    "restart_syscall": (219, 128),
    "sched_yield": (24, 124),
    "select": (23, None),
    "times": (100, 153),
    # identity and limits of the process
    "getegid": (108, 177),
    "geteuid": (107, 175),
    "getgid": (104, 176),
    "getpid": (39, 172),
    "getppid": (110, 173),
    "getrandom": (318, 278),
    "getrlimit": (97, 163),
    "getrusage": (98, 165),
    "gettid": (186, 178),
    "getuid": (102, 174),
    "sched_getaffinity": (204, 123),
    "sysinfo": (99, 179),
    "uname": (63, 160),
    # handling of signals, and its end
    "exit": (60, 93),
    "exit_group": (231, 94),
    "rt_sigaction": (13, 134),
    "rt_sigprocmask": (14, 135),
    "rt_sigreturn": (15, 139),
    "sigaltstack": (131, 132),
}
"""System calls that reading needs, with their numbers on each of the architectures; None where there is none."""
_OPEN: Final[tuple[tuple[tuple[int, int | None], int], ...]] = (((2, None), 1), ((257, 56), 2))
"""Numbers of ``open`` and ``openat``, and the argument with the flags."""
_CHANGES_FILE: Final = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_FCNTL: Final = (72, 25)
_OF_DESCRIPTORS: Final = (fcntl.F_DUPFD, fcntl.F_GETFD, fcntl.F_SETFD, fcntl.F_GETFL, fcntl.F_DUPFD_CLOEXEC)
"""Commands of ``fcntl`` that cannot lock a file, and cannot have the kernel send a signal."""
_PRLIMIT: Final = (302, 261)
_ITSELF: Final = 0
_NEWER: Final = 424
"""First number of the newer system calls, the same on all architectures. Libraries know that older kernels do not have
these, and use older ones instead."""

_CREATE_RULES, _RESTRICT = 444, 446
_VERSION: Final = 1
_FILE_CHANGES: Final = {1: 0x1FF3, 2: 1 << 13, 3: 1 << 14, 5: 1 << 15}
"""Landlock's rights to change or execute files, or to control devices, by the version in which they came."""
_NETWORK, _SCOPES = 4, 6
"""Versions of Landlock with which TCP, and then abstract sockets and signals can be refused."""

Step = tuple[int, int, int, int]
"""Instruction of a filter: code, how many to skip if the comparison holds, and if it does not, and a value."""


def confine(memory: int, seconds: int) -> None:
    """Drop all rights that reading a file does not need.

    Afterwards no thread of this process can open a socket, start a program, a process or a thread, send a signal,
    change limits or memory of another process, lock, make, change or remove a file, or open a device for writing. It
    leaves no core dump, which would hold a patient's data. It ends when its parent does. It can read what its account
    can read, except, with Landlock, the memory and open files of other processes.

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
        (resource.RLIMIT_NPROC, 0),
    ):
        _, most = resource.getrlimit(limit)
        value = value if most == resource.RLIM_INFINITY else min(value, most)
        resource.setrlimit(limit, (value, value))
    libc = ctypes.CDLL(None, use_errno=True)
    _check(libc.prctl(_PARENT_DEATH, signal.SIGKILL, 0, 0, 0))
    _check(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
    _refuse_changes(libc)
    _filter_calls(libc)


def landlock_version() -> int:
    """Return the version of the kernel's Landlock; 0 if this process cannot use it."""
    return _landlock_version(ctypes.CDLL(None, use_errno=True))


def _landlock_version(libc: ctypes.CDLL) -> int:
    return max(0, int(libc.syscall(_CREATE_RULES, None, ctypes.c_size_t(0), _VERSION)))


def _refuse_changes(libc: ctypes.CDLL) -> None:
    version = _landlock_version(libc)
    if not version:
        return
    refused = [sum(rights for since, rights in _FILE_CHANGES.items() if version >= since)]
    refused += [0b11] * (version >= _NETWORK) + [0b11] * (version >= _SCOPES)
    described = struct.pack(f"{len(refused)}Q", *refused)
    rules = libc.syscall(_CREATE_RULES, described, ctypes.c_size_t(len(described)), 0)
    _check(min(rules, 0))
    try:
        _check(libc.syscall(_RESTRICT, rules, 0))  # no rule was added: there is no exception
    finally:
        os.close(rules)


def _filter_calls(libc: ctypes.CDLL) -> None:
    machine = platform.machine()
    if machine not in _ARCHITECTURES:
        raise NotImplementedError(f"Files are read on {' and '.join(_ARCHITECTURES)} only, not on {machine}.")
    column = list(_ARCHITECTURES).index(machine)
    steps = list(_steps(_ARCHITECTURES[machine], column))
    program = b"".join(struct.pack("HBBI", *step) for step in steps)
    buffer = ctypes.create_string_buffer(program, len(program))
    described = struct.pack("HxxxxxxP", len(steps), ctypes.addressof(buffer))
    described_at = ctypes.create_string_buffer(described, len(described))
    _check(libc.syscall(_SECCOMP[column], _SET_FILTER, _OF_ALL_THREADS, described_at))


def _steps(architecture: int, column: int) -> Iterator[Step]:
    """Yield the instructions of the filter.

    Args:
        architecture: The kernel's name of the architecture.
        column: Place of the architecture's numbers in the tables.
    """
    yield _LOAD, 0, 0, _ARCHITECTURE
    yield from _if((_IS, architecture), [(_LOAD, 0, 0, _NUMBER)], [(_RETURN, 0, 0, _REFUSE)])
    for numbers in _CALLS.values():
        yield from _for_call(numbers[column], [(_RETURN, 0, 0, _ALLOW)])
    for numbers, flags in _OPEN:
        changes = _if((_HAS_ANY, _CHANGES_FILE), [(_RETURN, 0, 0, _REFUSE)], [(_RETURN, 0, 0, _ALLOW)])
        yield from _for_call(numbers[column], [_argument(flags), *changes])
    yield from _for_call(_FCNTL[column], _only(1, _OF_DESCRIPTORS))
    yield from _for_call(_PRLIMIT[column], _only(0, (_ITSELF,)))
    yield from _if((_AT_LEAST, _NEWER), [(_RETURN, 0, 0, _NOT_THERE)], [(_RETURN, 0, 0, _REFUSE)])


def _if(condition: tuple[int, int], then: list[Step], otherwise: list[Step]) -> list[Step]:
    """Return the instructions that compare, and do one or the other; `otherwise` must return."""
    code, value = condition
    return [(code, len(otherwise), 0, value), *otherwise, *then]


def _for_call(number: int | None, then: list[Step]) -> list[Step]:
    """Return the instructions for one system call; `then` must return."""
    return [] if number is None else [(_IS, 0, len(then), number), *then]


def _argument(place: int) -> Step:
    """Return the instruction that loads the lower half of an argument, which is all that the kernel uses of these."""
    return _LOAD, 0, 0, _ARGUMENTS + 8 * place


def _only(place: int, values: tuple[int, ...]) -> list[Step]:
    """Return the instructions that allow a call with one of these values of an argument."""
    steps = [_argument(place)]
    for value in values:
        steps += [(_IS, 0, 1, value), (_RETURN, 0, 0, _ALLOW)]
    return [*steps, (_RETURN, 0, 0, _REFUSE)]


def _check(status: int) -> None:
    if status != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"The process cannot be confined: {os.strerror(number)}.")
