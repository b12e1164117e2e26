"""The recorder of the daemon's session, as a child process."""

from __future__ import annotations

import asyncio
import datetime

from pcmrs.clock import Clock
from pcmrs.processes.starting import Process, ProcessStarter
from pcmrs.recording.settings import FOLDER
from pcmrs.service.processes.child import open_child
from pcmrs.settings import Settings


async def start_recording(
    start: ProcessStarter, settings: Settings, session: str, clock: Clock, device_key: bytes
) -> Process:
    """Start the process that records the session into a new file in the cell's folder.

    Args:
        start: Starts the process.
        settings: Settings of the daemon.
        session: Id of the session in the journal.
        clock: The machine's clock.
        device_key: Key to seal its reports to the daemon.

    Raises:
        OSError: The folder cannot be created, or the process cannot be started.
    """
    folder = settings.cell.path() / FOLDER
    folder.mkdir(exist_ok=True)
    begun = datetime.datetime.fromtimestamp(clock.wall(), datetime.UTC)
    name = f"{begun:%Y%m%dT%H%M%SZ}-{session[:8]}.mcap"
    words = ("record", str(folder / name), "--lifeline", "--session", session)
    return await open_child(start, *words, settings=settings, device_key=device_key, stdout=asyncio.subprocess.DEVNULL)
