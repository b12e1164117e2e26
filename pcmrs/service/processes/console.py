"""Page of the cell, served by a child process on this machine."""

from __future__ import annotations

import asyncio
import secrets
from importlib.util import find_spec

from pcmrs.console.settings import TOKEN
from pcmrs.files import SECRET, write_durably
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.service.processes.child import open_child
from pcmrs.settings import Settings


def is_served(settings: Settings) -> bool:
    """Return whether the daemon serves the page: it is enabled, and its packages are installed."""
    return settings.console.enabled and find_spec("nicegui") is not None


async def open_console(start: ProcessStarter, settings: Settings) -> Process:
    """Start the process that serves the page. Its token is in the cell's folder, and is created if there is none.

    Raises:
        OSError: The token cannot be written, or the process cannot be started.
    """
    token = settings.cell.path() / TOKEN
    if not token.exists():
        write_durably(token, secrets.token_urlsafe(24).encode(), mode=SECRET)
    return await open_child(start, "console", "--lifeline", settings=settings, stdout=asyncio.subprocess.DEVNULL)
