"""Start of a child process as ``python -m MODULE WORDS``."""

from __future__ import annotations

import asyncio
import sys
from typing import Protocol

from pcmrs.killing import KillableProcess


class Process(KillableProcess, Protocol):
    """What the daemon uses of `asyncio.subprocess.Process`."""

    @property
    def pid(self) -> int: ...

    @property
    def returncode(self) -> int | None: ...

    @property
    def stdin(self) -> asyncio.StreamWriter | None: ...

    @property
    def stdout(self) -> asyncio.StreamReader | None: ...

    def terminate(self) -> None: ...


class ProcessStarter(Protocol):
    """Starter of child processes, each in its own session: a Ctrl-C at the terminal is the daemon's to handle."""

    async def __call__(
        self,
        module: str,
        *words: str,
        stdin: int = asyncio.subprocess.PIPE,
        stdout: int | None = None,
        passed: int | None = None,
    ) -> Process:
        """Start ``python -m MODULE WORDS``.

        Args:
            module: Module with a function ``main``.
            words: Its command line.
            stdin: A file descriptor, or ``PIPE``.
            stdout: ``PIPE``, ``DEVNULL``, or None for that of this process.
            passed: A further file descriptor, which the child has under the same number; None for none.

        Raises:
            OSError: The process cannot be started.
        """


async def start_by_exec(
    module: str,
    *words: str,
    stdin: int = asyncio.subprocess.PIPE,
    stdout: int | None = None,
    passed: int | None = None,
) -> Process:
    """Start a new Python, which imports everything itself; see `ProcessStarter`."""
    command = (sys.executable, "-m", module, *words)
    return await asyncio.create_subprocess_exec(
        *command, stdin=stdin, stdout=stdout, start_new_session=True, pass_fds=() if passed is None else (passed,)
    )
