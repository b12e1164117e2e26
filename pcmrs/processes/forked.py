"""The fork server: a process that has imported what the daemon's children need, and forks them on request.

It is itself a fork of the daemon, made before the daemon has an event loop, threads or open files. So a child needs no
further imports, and shares its memory with the others. The server does nothing else, and ends with the daemon.
"""

from __future__ import annotations

import atexit
import fcntl
import gc
import importlib
import os
import selectors
import socket
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NoReturn

import msgspec
from setproctitle import setproctitle

LARGEST = 65536
"""Limit of a message, bytes: a request holds a command line."""
MOST_DESCRIPTORS = 3
"""Limit of the descriptors of a request: standard input and output, and one more."""


class ForkRequest(msgspec.Struct, frozen=True):
    """Start of a child; comes with its file descriptors: those of its standard streams, and at most one more.

    Attributes:
        number: Number of the request.
        module: Module whose ``main`` it runs.
        words: Its command line.
        numbers: Numbers that the descriptors have in the child.
        silent: True to discard its standard output.
    """

    number: int
    module: str
    words: tuple[str, ...]
    numbers: tuple[int, ...]
    silent: bool


class Started(msgspec.Struct, frozen=True, tag=True):
    """A child has been started; comes with a descriptor of the process.

    Attributes:
        number: Number of the request.
        pid: Id of the process.
    """

    number: int
    pid: int


class StartFailed(msgspec.Struct, frozen=True, tag=True):
    """A child cannot be started.

    Attributes:
        number: Number of the request.
        error: Number of the system's error.
    """

    number: int
    error: int


class Ended(msgspec.Struct, frozen=True, tag=True):
    """A child has ended.

    Attributes:
        pid: Id of the process.
        status: Exit status; the negative number of the signal that ended it.
    """

    pid: int
    status: int


ForkAnswer = Started | StartFailed | Ended


class _Server:
    """Server of requests.

    Args:
        control: Socket of the daemon; its end is the daemon's end.
    """

    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)
        self._children: dict[int, int] = {}  # descriptor of a process to its id

    def run(self) -> NoReturn:
        while True:
            for key, _ in self._selector.select():
                if key.fd == self._control.fileno():
                    self._serve()
                else:
                    self._reap(key.fd)

    def _serve(self) -> None:
        message, descriptors, *_ = socket.recv_fds(self._control, LARGEST, MOST_DESCRIPTORS)
        if not message:
            os._exit(0)
        request = msgspec.json.decode(message, type=ForkRequest)
        try:
            pid = os.fork()
        except OSError as error:
            self._answer(StartFailed(request.number, error.errno or 0))
        else:
            if pid == 0:
                self._become(request, descriptors)
            process = os.pidfd_open(pid)
            self._children[process] = pid
            self._selector.register(process, selectors.EVENT_READ)
            self._answer(Started(request.number, pid), process)
        finally:
            for each in descriptors:
                os.close(each)

    def _reap(self, process: int) -> None:
        self._selector.unregister(process)
        os.close(process)
        pid = self._children.pop(process)
        _, status = os.waitpid(pid, 0)
        self._answer(Ended(pid, os.waitstatus_to_exitcode(status)))

    def _answer(self, answer: ForkAnswer, *descriptors: int) -> None:
        with suppress(BrokenPipeError):  # the daemon has ended, which the next read tells
            socket.send_fds(self._control, [msgspec.json.encode(answer)], descriptors)

    def _become(self, request: ForkRequest, descriptors: Sequence[int]) -> NoReturn:
        """Turn the new process into the child."""
        status = 1
        try:
            self._selector.close()
            self._control.close()
            for each in self._children:
                os.close(each)
            os.setsid()
            _renumber(descriptors, request.numbers)
            if request.silent:
                discarding = os.open(os.devnull, os.O_WRONLY)
                os.dup2(discarding, 1)
                os.close(discarding)
            status = run_main(request.module, request.words)
        finally:
            os._exit(status)


def _renumber(descriptors: Sequence[int], numbers: Sequence[int]) -> None:
    """Give descriptors of this process other numbers."""
    # First to numbers above all wanted ones, so that no descriptor overwrites another, or itself.
    beyond = max(numbers, default=0) + 1
    moved = [fcntl.fcntl(each, fcntl.F_DUPFD, beyond) for each in descriptors]
    for each in descriptors:
        os.close(each)
    for each, number in zip(moved, numbers, strict=True):
        os.dup2(each, number)
        os.close(each)


def serve_forks(control: socket.socket, modules: Iterable[str]) -> NoReturn:
    """Serve requests until the daemon ends.

    Args:
        control: Socket of the daemon.
        modules: Modules of the children, which are imported once.
    """
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError:  # refused by a container, for example: the daemon goes on without this server
        os._exit(1)
    os.setsid()  # a Ctrl-C at the terminal is the daemon's to handle
    setproctitle(f"{sys.executable} -m {__name__}")
    for name in modules:
        with suppress(ModuleNotFoundError):  # of an extra that is not installed: the child says so itself
            importlib.import_module(name)
    gc.collect()
    gc.freeze()  # the collector of a child would otherwise write to, and so copy, all shared memory
    _Server(control).run()


def run_main(module: str, words: Sequence[str]) -> int:
    """Run the function ``main`` of a module as ``python -m MODULE WORDS`` would, in a process that was just forked.

    What the module registers with `atexit` is called, such as the end of the log; what the parent registered is not.

    Args:
        module: Name of the module.
        words: Its command line.

    Returns:
        Exit status. An exception is printed, and not raised.
    """
    # As multiprocessing does it: there is no public way to forget or to call what is registered.
    atexit._clear()  # noqa: SLF001
    status = 1
    try:
        sys.argv = [module, *words]
        setproctitle(" ".join((sys.executable, "-m", *sys.argv)))
        importlib.import_module(module).main()
        status = 0
    except SystemExit as ending:
        status = _status_of(ending)
    except BaseException:
        traceback.print_exc()
    atexit._run_exitfuncs()  # noqa: SLF001
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        sys.stderr.flush()
    return status


def _status_of(ending: SystemExit) -> int:
    match ending.code:
        case None:
            return 0
        case int(code):
            return code
        case text:
            sys.stderr.write(f"{text}\n")
            return 1
