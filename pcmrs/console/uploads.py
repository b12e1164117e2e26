"""No request has a longer body than an upload may have: the browser's own check binds nobody who sends by himself.

Temporary files of the console: a patient's files are among them, so that what a killed one has left is removed.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcmrs.console.guard import App, Receive, Scope, Send, answer
from pcmrs.errors import ConfigurationError
from pcmrs.files import make_private


def keep_temporary_files(folder: Path) -> None:
    """Have all temporary files of this process, those of the web server too, lie in a folder of its own below this one.

    Those of processes that have ended are removed: the kernel ends the lock on a folder with the process that holds it.

    Raises:
        ConfigurationError: The folder cannot be made.
    """
    try:
        make_private(folder)
        with _locked(folder):
            for left in folder.iterdir():
                if _is_left(left):
                    shutil.rmtree(left, ignore_errors=True)
            own = tempfile.mkdtemp(dir=folder)
            fcntl.flock(os.open(own, os.O_RDONLY), fcntl.LOCK_EX)  # as long as this process lives
    except OSError as error:
        text = f"The folder for uploads, {folder}, cannot be made: {error.strerror}."
        raise ConfigurationError(text, folder=str(folder)) from None
    tempfile.tempdir = own


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one process at a time look at what others have left, and make its own."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _is_left(folder: Path) -> bool:
    """Whether the process that it was made for has ended."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True


class UploadLimit:
    """Stands before the application and refuses a request whose body is too long, or of unknown length, unread.

    The server in front reads no more of a body than its ``content-length`` says.

    Args:
        app: What is behind it.
        largest: Bytes of a body, those that a form adds included.
    """

    def __init__(self, app: App, largest: int) -> None:
        self._app = app
        self._largest = largest

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through as long as it is short enough."""
        headers = dict(scope["headers"]) if scope["type"] == "http" else {}
        length = headers.get(b"content-length", b"")
        if b"transfer-encoding" in headers:
            await answer(send, 411, "A request says how long its body is: Content-Length.", {"connection": "close"})
        elif length.isdigit() and int(length) > self._largest:
            await answer(send, 413, f"The limit is {self._largest} bytes.", {"connection": "close"})
        else:
            await self._app(scope, receive, send)
