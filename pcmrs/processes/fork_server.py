"""The daemon's side of the fork server, which starts its child processes; see `pcmrs.processes.forked`."""

from __future__ import annotations

import asyncio
import gc
import itertools
import os
import signal
import socket
from collections.abc import Iterable
from contextlib import suppress
from typing import Self

import msgspec
import structlog

from pcmrs.processes.forked import LARGEST, Ended, ForkAnswer, ForkRequest, Started, StartFailed, serve_forks
from pcmrs.processes.starting import Process, start_by_exec

log = structlog.get_logger(__name__)

ANSWER_TIME = 60.0
"""Limit for the answer to a request, s: on a busy machine the server's imports alone take long."""
UNKNOWN_STATUS = 255
"""Exit status of a child whose end the server did not live to see."""


class ForkedProcess:
    """A child; see `pcmrs.processes.starting.Process`.

    Args:
        pid: Id of the process.
        descriptor: Descriptor of the process, which stays this process even if its id is used again.

    Attributes:
        pid: Id of the process.
        stdin: Its standard input, if that is a pipe.
        stdout: Its standard output, if that is a pipe.
    """

    def __init__(self, pid: int, descriptor: int) -> None:
        self.pid = pid
        self.stdin: asyncio.StreamWriter | None = None
        self.stdout: asyncio.StreamReader | None = None
        self._descriptor = descriptor
        self._ended: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    @property
    def returncode(self) -> int | None:
        """Exit status, or the negative number of the signal that ended it; None while it runs."""
        return self._ended.result() if self._ended.done() else None

    async def wait(self) -> int:
        """Wait for its end; return its exit status."""
        return await asyncio.shield(self._ended)

    async def communicate(self) -> tuple[bytes | None, bytes | None]:
        """Wait for its end; return what is left of its standard output."""
        output = None if self.stdout is None else await self.stdout.read()
        await self.wait()
        return output, None

    def kill(self) -> None:
        """Send SIGKILL."""
        self._send(signal.SIGKILL)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self._send(signal.SIGTERM)

    def end(self, status: int) -> None:
        """Note that it has ended."""
        self._ended.set_result(status)
        os.close(self._descriptor)
        if self.stdin is not None:
            self.stdin.close()

    def watch_end(self) -> None:
        """Note its end without the server: as soon as the system tells it, with `UNKNOWN_STATUS`."""
        loop, descriptor = asyncio.get_running_loop(), self._descriptor

        def ended() -> None:
            loop.remove_reader(descriptor)
            self.end(UNKNOWN_STATUS)

        loop.add_reader(descriptor, ended)

    def _send(self, number: signal.Signals) -> None:
        if not self._ended.done():
            signal.pidfd_send_signal(self._descriptor, number)


class _LostError(Exception):
    """The fork server has ended, or does not answer; never leaves this module."""


class ForkServer:
    """Starter of children by fork; an implementation of `pcmrs.processes.starting.ProcessStarter`.

    If the server is lost, its children go on, and later ones are started without it.

    Args:
        control: Socket of the server.
        pid: Id of the server.
    """

    def __init__(self, control: socket.socket, pid: int) -> None:
        self._control, self._pid = control, pid
        self._numbers = itertools.count(1)
        self._pending: dict[int, asyncio.Future[ForkedProcess]] = {}
        self._children: dict[int, ForkedProcess] = {}
        self._attached = self._lost = False

    @classmethod
    def fork(cls, modules: Iterable[str]) -> Self:
        """Fork the server. Call it before there are threads of this program, an event loop, or open files.

        Args:
            modules: Names of the modules of the children, beyond what this process has imported.
        """
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        gc.freeze()
        pid = os.fork()
        if pid == 0:
            ours.close()
            serve_forks(theirs, modules)
        theirs.close()
        return cls(ours, pid)

    async def __call__(
        self,
        module: str,
        *words: str,
        stdin: int = asyncio.subprocess.PIPE,
        stdout: int | None = None,
        passed: int | None = None,
    ) -> Process:
        """See `ProcessStarter`."""
        with suppress(_LostError):
            if stdin == asyncio.subprocess.PIPE:
                return await self._with_pipes(module, words, stdout, passed)
            return await self._request(module, words, stdin, stdout, passed)
        return await start_by_exec(module, *words, stdin=stdin, stdout=stdout, passed=passed)

    def close(self) -> None:
        """End the server, after the event loop; its children go on."""
        if not self._lost:
            self._end()

    async def _with_pipes(self, module: str, words: tuple[str, ...], stdout: int | None, passed: int | None) -> Process:
        here, there = socket.socketpair()
        try:
            with there:
                process = await self._request(module, words, there.fileno(), stdout, passed)
        except BaseException:
            here.close()  # a child that has started after all ends with its input
            raise
        here.setblocking(False)
        process.stdout, process.stdin = await asyncio.open_unix_connection(sock=here)
        if process.returncode is not None:  # it has ended meanwhile
            process.stdin.close()
        return process

    async def _request(
        self, module: str, words: tuple[str, ...], stdin: int, stdout: int | None, passed: int | None
    ) -> ForkedProcess:
        if self._lost:
            raise _LostError
        if not self._attached:
            self._attached = True
            asyncio.get_running_loop().add_reader(self._control, self._receive)
        given = {0: stdin}
        if stdout == asyncio.subprocess.PIPE:
            given[1] = stdin
        if passed is not None:
            given[passed] = passed
        number = next(self._numbers)
        request = ForkRequest(number, module, words, tuple(given), silent=stdout == asyncio.subprocess.DEVNULL)
        started: asyncio.Future[ForkedProcess] = asyncio.get_running_loop().create_future()
        self._pending[number] = started
        try:
            socket.send_fds(self._control, [msgspec.json.encode(request)], list(given.values()))
            async with asyncio.timeout(ANSWER_TIME):
                return await started
        except (TimeoutError, ConnectionError):
            self._lose()
            raise _LostError from None
        finally:
            self._pending.pop(number, None)

    def _receive(self) -> None:
        try:
            message, descriptors, *_ = socket.recv_fds(self._control, LARGEST, 1, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return
        except OSError:
            message = b""
        if not message:
            self._lose()
            return
        match msgspec.json.decode(message, type=ForkAnswer):
            case Started(number, pid):
                child = self._children[pid] = ForkedProcess(pid, descriptors[0])
                self._answer(number, child)
            case StartFailed(number, error):
                self._answer(number, OSError(error, os.strerror(error)))
            case Ended(pid, status):
                self._children.pop(pid).end(status)

    def _answer(self, number: int, answer: ForkedProcess | OSError) -> None:
        started = self._pending.get(number)
        if started is None or started.done():  # cancelled: the child ends with its input
            return
        if isinstance(answer, OSError):
            started.set_exception(answer)
        else:
            started.set_result(answer)

    def _lose(self) -> None:
        """Go on without the server, which has ended by itself or hangs."""
        if self._lost:
            return
        self._lost = True
        asyncio.get_running_loop().remove_reader(self._control)
        log.error("fork_server_lost", text="Children go on; new ones are started without it, which takes longer.")
        self._end()
        for started in self._pending.values():
            if not started.done():
                started.set_exception(_LostError())
        for child in self._children.values():
            child.watch_end()

    def _end(self) -> None:
        self._control.close()
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
