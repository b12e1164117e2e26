"""A child process that writes what a test says, in place of a real one."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from tests.unit.lab.campaign.scripted_cell import ScriptedProcess


class ScriptedChild(ScriptedProcess):
    """A child that has written `output`, and writes `last` when its input ends.

    Attributes:
        words: Command line with which it was started.
        options: Other arguments of its start.
        typed: What it has read.
    """

    def __init__(self, output: bytes = b"", last: bytes = b"", errors: bytes = b"") -> None:
        super().__init__()
        self.words: tuple[str, ...] = ()
        self.options: dict[str, Any] = {}
        self.typed = b""
        self.stdin = self
        self._output, self._last, self._errors = output, last, errors

    def _begin(self) -> None:
        self.stdout, self.stderr = asyncio.StreamReader(), asyncio.StreamReader()
        self.stdout.feed_data(self._output)
        if not self._last:
            self.stdout.feed_eof()
        self.stderr.feed_data(self._errors)
        self.stderr.feed_eof()

    def write(self, text: bytes) -> None:
        self.typed += text

    def close(self) -> None:
        """Ends its input, and with it the process."""
        if self._last:
            self.stdout.feed_data(self._last)
            self.stdout.feed_eof()
        self.returncode = 0 if self.returncode is None else self.returncode

    async def communicate(self) -> tuple[bytes, bytes]:
        await self.wait()
        return b"", b""


def started(monkeypatch: pytest.MonkeyPatch, *children: ScriptedChild) -> None:
    """Starts these children, one after the other, in place of every process."""
    waiting = list(children)

    async def start(*words: str, **options: Any) -> ScriptedChild:
        child = waiting.pop(0)
        child.words, child.options = words, options
        child._begin()
        return child

    monkeypatch.setattr("asyncio.create_subprocess_exec", start)
