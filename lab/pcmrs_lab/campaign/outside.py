"""Device nodes that no daemon starts, like those on another machine: they outlive it, and reach it anywhere."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

from pcmrs.service.processes.child import end_child

DEVICES = ("robot", "tracker", "pointer", "scene")
WITHOUT_NODES = tuple(f"{device}.driver=none" for device in (*DEVICES, "stimulator", "emg"))
"""Settings of a daemon that starts no nodes."""

END_TIME = 5.0


@asynccontextmanager
async def outside_node(settings: Sequence[str], log: Path) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run a node of the simulated devices for the length of the context; it retries until it reaches its bus.

    Args:
        settings: Settings of its daemon, but with ``cell.endpoint`` as this node reaches the bus.
        log: File for its standard error.

    Yields:
        Process of the node.
    """
    simulated = [setting for setting in settings if setting not in WITHOUT_NODES]
    words = [word for setting in simulated for word in ("--set", setting)]
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "pcmrs.cli", "node", "sim", *DEVICES, *words,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=errors,
        )  # fmt: skip
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.send_signal(signal.SIGCONT)
            process.terminate()
        await end_child(process, END_TIME)
