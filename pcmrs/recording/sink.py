"""One file as the writer of MCAP sees it: it counts, and a full disk never reaches the writer."""

from __future__ import annotations

import os
from collections.abc import Callable
from io import SEEK_CUR, SEEK_SET
from pathlib import Path


class CountingFile:
    """A new file that is only ever appended to.

    An error of the disk is kept, and what comes afterwards is thrown away: the writer would report the same error for
    each message, and could not even be closed.

    Args:
        path: Of the file; must not exist.

    Attributes:
        size: Bytes written.
        error: What went wrong first; None so far.

    Raises:
        OSError: It exists, or cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.size = 0
        self.error: OSError | None = None
        self._file = path.open("xb", buffering=1 << 16)

    def write(self, data: bytes | bytearray) -> int:
        """Appends all of it."""
        self._attempt(lambda: self._file.write(data))
        self.size += len(data)
        return len(data)

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        """The end, where the writer is and stays. Raises `OSError` for any other place."""
        if (offset, whence) not in ((0, SEEK_CUR), (self.size, SEEK_SET)):
            raise OSError(f"{self._file.name} can only be appended to.")
        return self.size

    def flush(self) -> None:
        """Hands everything to the operating system, so that it survives the end of this process."""
        self._attempt(self._file.flush)

    def close(self) -> None:
        """Ends the file; the disk has it then."""
        self._attempt(self._file.flush)
        self._attempt(lambda: os.fsync(self._file.fileno()))
        try:
            self._file.close()
        except OSError as error:  # what could not be flushed before
            self.error = self.error or error

    def _attempt(self, act: Callable[[], object]) -> None:
        if self.error is None:
            try:
                act()
            except OSError as error:
                self.error = error
