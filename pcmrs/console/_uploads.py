"""Limits of uploads on the server, since a browser's own check binds no other client; and temporary files.

Temporary files may hold data of patients, so the files of a killed console are removed.
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


def use_temporary_folder(folder: Path) -> None:
    """Put all temporary files of this process, also those of the web server, into its own folder below this one.

    Folders of processes that have ended are removed: the kernel releases the lock on a folder with its process.

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
            fcntl.flock(os.open(own, os.O_RDONLY), fcntl.LOCK_EX)  # locked until this process ends
    except OSError as error:
        text = f"The folder for uploads, {folder}, cannot be made: {error.strerror}."
        raise ConfigurationError(text, folder=str(folder)) from None
    tempfile.tempdir = own


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Let one process at a time check the files that others have left, and make its own folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _is_left(folder: Path) -> bool:
    """Return true if the process that made it has ended."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True


class UploadLimit:
    """Middleware that refuses, unread, a request whose body is too long, or of unknown length.

    The server before it reads no more of a body than its ``content-length``.

    Args:
        app: Application behind it.
        largest: Limit of a body, bytes, with the bytes that a form adds.
    """

    def __init__(self, app: App, largest: int) -> None:
        self._app = app
        self._largest = largest

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through if it is short enough."""
        headers = dict(scope["headers"]) if scope["type"] == "http" else {}
        length = headers.get(b"content-length", b"")
        if b"transfer-encoding" in headers:
            await answer(send, 411, "A request needs the length of its body: Content-Length.", {"connection": "close"})
        elif length.isdigit() and int(length) > self._largest:
            await answer(send, 413, f"The limit is {self._largest} bytes.", {"connection": "close"})
        else:
            await self._app(scope, receive, send)
