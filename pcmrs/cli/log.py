"""The log of a daemon or node, written by its own thread: logging can neither fail nor delay its caller."""

from __future__ import annotations

import atexit
import io
import logging
import os
import queue
import sys
import threading
from collections.abc import MutableMapping
from typing import TYPE_CHECKING, Any, TextIO, cast

from pcmrs.lean_structlog import structlog
from pcmrs.visible import visible

if TYPE_CHECKING:
    from structlog.typing import ExcInfo

STANDARD_ERROR = 2
MAX_WAITING = 1000
"""Limit of lines that wait to be written; further lines are lost."""
CLOSE_TIMEOUT = 1.0
"""Longest wait of an ending process until its log is written, s."""


class LogStream:
    """A text stream that accepts everything at once; lines that cannot be written are counted and dropped.

    A full disk, a closed terminal, or a reader that does not read stops nobody. Lost lines are reported as
    soon as something can be written again.

    Args:
        descriptor: Descriptor of the file to write to.
    """

    def __init__(self, descriptor: int) -> None:
        self._overflowed = self._unwritten = self._reported = 0
        self._descriptor = descriptor
        self._lines: queue.Queue[str | None] = queue.Queue(MAX_WAITING)
        self._thread = threading.Thread(target=self._write_all, name="pcmrs-log", daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        """Number of lines that were not written."""
        return self._overflowed + self._unwritten

    def write(self, text: str) -> int:
        """Accept a line without waiting."""
        # A caller in the event loop must never wait for a disk or a terminal.
        try:
            self._lines.put_nowait(text)
        except queue.Full:
            self._overflowed += 1
        return len(text)

    def flush(self) -> None:
        """Do nothing: the thread writes as soon as it can."""

    def close(self) -> None:
        """Wait until everything is written, at most `CLOSE_TIMEOUT`."""
        try:
            self._lines.put(None, timeout=CLOSE_TIMEOUT)  # ends the thread after all earlier lines
        except queue.Full:
            return
        self._thread.join(CLOSE_TIMEOUT)

    def _write_all(self) -> None:
        while (line := self._lines.get()) is not None:
            self._report_lost()
            self._unwritten += not self._written(line)

    def _report_lost(self) -> None:
        lost = self.lost
        if lost > self._reported and self._written(f"{lost - self._reported} lines of the log were lost\n"):
            self._reported = lost

    def _written(self, text: str) -> bool:
        data = text.encode(errors="replace")
        try:
            while data:
                data = data[os.write(self._descriptor, data) :]
        except OSError:
            return False
        return True


def log_to_stderr(*, verbose: bool = False) -> LogStream:
    """Send everything that this process logs to standard error, and write it before the process ends."""
    level = logging.DEBUG if verbose else logging.INFO
    # Without a standard error at the start, its number may belong to another file now.
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
            # A rich traceback with its locals takes most of a second of the event loop.
            structlog.dev.ConsoleRenderer(colors=os.isatty(descriptor), exception_formatter=_write_traceback),
        ],
        logger_factory=structlog.WriteLoggerFactory(cast(TextIO, stream)),
    )
    log_standard_library(cast(TextIO, stream), logging.BASIC_FORMAT, level)
    return stream


def log_standard_library(stream: TextIO, line: str, level: int = logging.INFO) -> None:
    """Write what the standard library's `logging` gets, which libraries use, too, to a stream, escaped.

    Args:
        stream: The stream.
        line: Format of a line, as for `logging.Formatter`.
        level: Lowest level that is written.
    """
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Escaping(line))
    logging.basicConfig(level=level, handlers=[handler])


def _escape(_logger: object, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Make every text of an event safe to show: names and reasons may come from outside."""
    return {visible(name): visible(value) if isinstance(value, str) else value for name, value in event.items()}


def _write_traceback(out: TextIO, info: ExcInfo) -> None:
    """Write a traceback with indented lines: the text of an exception may come from outside, and have several lines."""
    text = io.StringIO()
    structlog.dev.plain_traceback(text, info)
    out.write("".join(f"  {visible(line)}\n" for line in text.getvalue().splitlines()))


class _Escaping(logging.Formatter):
    """Formatter that escapes each line, and indents all but the first."""

    def format(self, record: logging.LogRecord) -> str:
        first, *more = super().format(record).split("\n")
        return "\n".join([visible(first), *(f"  {visible(line)}" for line in more)])
