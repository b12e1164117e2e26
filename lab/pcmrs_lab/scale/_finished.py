"""File of finished tasks, with which an interrupted run continues."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec

from pcmrs.errors import ConfigurationError, FileFormatError


class _Line(msgspec.Struct, frozen=True):
    """One finished task.

    Attributes:
        function: Name of the function.
        version: Version of the code.
        task: The task, with its seed, as JSON.
        result: Its result, MessagePack.
    """

    function: str
    version: str
    task: msgspec.Raw
    result: bytes


class FinishedTasks:
    """Finished tasks of one function and one version of the code; those of others stay in the file.

    They are on the disk when `add` returns. A line that was being written when the machine failed is removed.

    Args:
        path: File, JSON lines; created if it is missing.
        function: Name of the function.
        version: Version of the code.

    Raises:
        ConfigurationError: Another run uses the file.
        FileFormatError: The file has other contents.
    """

    def __init__(self, path: Path, function: str, version: str) -> None:
        self._function, self._version = function, version
        self._results: dict[bytes, bytes] = {}
        self._file = path.open("a+b")
        try:
            self._read(path)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def get(self, task: bytes) -> bytes | None:
        """Return the result of a task; None if it is not finished."""
        return self._results.get(task)

    def add(self, tasks: Iterable[bytes], results: Iterable[bytes]) -> None:
        """Append finished tasks, and wait until they are on the disk.

        Args:
            tasks: Tasks, as JSON.
            results: Their results, MessagePack.
        """
        for task, result in zip(tasks, results, strict=True):
            line = _Line(self._function, self._version, msgspec.Raw(task), result)
            self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, path: Path) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigurationError(
                f"{path} is used by another run: wait for its end, or name another file."
            ) from None
        self._file.seek(0)
        whole = 0
        for number, text in enumerate(self._file, 1):
            if not text.endswith(b"\n"):
                self._file.truncate(whole)
                break
            whole += len(text)
            try:
                line = msgspec.json.decode(text, type=_Line)
            except msgspec.MsgspecError as error:
                raise FileFormatError(f"Line {number} of {path} is not a finished task: {error}.") from None
            if (line.function, line.version) == (self._function, self._version):
                self._results[bytes(line.task)] = line.result
