"""Child processes of the daemon: given its settings, and never left behind."""

from __future__ import annotations

import asyncio
import sys
from typing import Any

import msgspec

from pcmrs.errors import DeviceError
from pcmrs.killing import killed
from pcmrs.settings import Inherited, Settings


async def open_child(
    *words: str, settings: Settings, device_key: bytes = b"", **streams: Any
) -> asyncio.subprocess.Process:
    """Starts ``pcmrs`` with the words as arguments, and hands it `Inherited` on its standard input.

    The pipe stays open: its end tells the child that the daemon is gone, however it went.

    Args:
        words: Of the command line.
        settings: Of the daemon.
        device_key: For a child that speaks as a device, or for the daemon; see `pcmrs.bus.seal`.
        streams: Standard output and error, if they are not the daemon's.

    Raises:
        OSError: It cannot be started.
    """
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "pcmrs.cli",
        *words,
        stdin=asyncio.subprocess.PIPE,
        start_new_session=True,  # a Ctrl-C at the terminal is the daemon's to handle
        **streams,
    )
    if process.stdin is None:
        raise DeviceError(f"pcmrs {words[0]} has no standard input.", words=list(words))
    process.stdin.write(msgspec.json.encode(Inherited(settings=settings, device_key=device_key)) + b"\n")
    return process


async def end_child(process: asyncio.subprocess.Process, patience: float) -> bool:
    """Waits for a process that was told to end, and kills it when it does not; whether it ended by itself.

    Args:
        process: The child.
        patience: s of the machine.
    """
    try:
        async with asyncio.timeout(patience):
            await process.wait()
    except TimeoutError:
        await killed(process)
        return False
    return True
