"""The log of a daemon or node: written by a thread of its own, so that it can neither fail nor delay who logs."""

from __future__ import annotations

import atexit
import io
import logging
import os
import queue
import sys
import threading
from collections.abc import MutableMapping
from typing import Any, TextIO, cast

import structlog
from structlog.typing import ExcInfo

from pcmrs.visible import visible

STANDARD_ERROR = 2
WAITING = 1000
"""Lines that may wait to be written; more are lost."""
LAST_WORDS = 1.0
"""A process that ends waits so long until what it has logged is written, s."""


class LogStream:
    """A stream of text that takes everything at once; what cannot be written is counted and dropped.

    A disk that is full, a terminal that is gone, or a reader that does not read stops nobody. What was lost is told as
    soon as something can be written again.

    Args:
        descriptor: Of the file that is written to.

    """

    def __init__(self, descriptor: int) -> None:
        self._overflowed = self._unwritten = self._told = 0
        self._descriptor = descriptor
        self._lines: queue.Queue[str | None] = queue.Queue(WAITING)
        self._thread = threading.Thread(target=self._write_all, name="pcmrs-log", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Lines that were not written."""
        return self._overflowed + self._unwritten

    def write(self, text: str) -> int:
        """Take a line; never waits."""
        try:
            self._lines.put_nowait(text)
        except queue.Full:
            self._overflowed += 1
        return len(text)

    def flush(self) -> None:
        """Does nothing: the thread writes as soon as it can."""

    def close(self) -> None:
        """Wait until everything is written, at most `LAST_WORDS`."""
        try:
            self._lines.put(None, timeout=LAST_WORDS)
        except queue.Full:
            return
        self._thread.join(LAST_WORDS)

    def _write_all(self) -> None:
        while (line := self._lines.get()) is not None:
            self._tell_lost()
            self._unwritten += not self._written(line)

    def _tell_lost(self) -> None:
        lost = self.lost
        if lost > self._told and self._written(f"{lost - self._told} lines of the log were lost\n"):
            self._told = lost

    def _written(self, text: str) -> bool:
        data = text.encode(errors="replace")
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            return False
        return True


def log_to_stderr(*, verbose: bool = False) -> LogStream:
    """From now on everything that this process logs goes to standard error, and is written before it ends."""
    level = logging.DEBUG if verbose else logging.INFO
    # Started without one, its number may have gone to another file.
    descriptor = STANDARD_ERROR if sys.__stderr__ is not None else os.open(os.devnull, os.O_WRONLY)
    stream = LogStream(descriptor)
    atexit.register(stream.close)
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso"),
            _escape,
            # A rich traceback with its locals takes the event loop most of a second.
            structlog.dev.ConsoleRenderer(colors=os.isatty(descriptor), exception_formatter=_write_traceback),
        ],
        logger_factory=structlog.WriteLoggerFactory(cast(TextIO, stream)),
    )
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Escaping(logging.BASIC_FORMAT))
    logging.basicConfig(level=level, handlers=[handler])
    return stream


def _escape(_logger: object, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Make every text of an event safe to show: names and reasons may come from outside."""
    return {visible(name): visible(value) if isinstance(value, str) else value for name, value in event.items()}


def _write_traceback(out: TextIO, info: ExcInfo) -> None:
    """Write a traceback, its lines indented: what an exception says may come from outside, and have lines."""
    text = io.StringIO()
    structlog.dev.plain_traceback(text, info)
    out.write("".join(f"  {visible(line)}\n" for line in text.getvalue().splitlines()))


class _Escaping(logging.Formatter):
    """Of the standard library's log: its own records and those of libraries."""

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([visible(first), *(f"  {visible(line)}" for line in more)])
