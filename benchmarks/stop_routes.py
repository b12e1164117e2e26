"""Cell that can be stopped by every route: sockets, bus, a page, a signing peer, and a remote operator.

The daemon has certificates and dials a router, a console serves its page, and a peer has a key. The remote operator has
a certificate and reaches the cell through the router, over TLS.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from stop_page import open_page

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.pki import Authority, read_credentials
from pcmrs.planner import Planner
from pcmrs.service.processes.child import end_child
from pcmrs.testing.cell import REAL_TIME, RunningCell, open_cell
from pcmrs.testing.daemon import free_port

ROUTES = ("udp", "tcp", "zenoh", "console", "signed", "remote")
BY_SOCKET = ("udp", "tcp", "signed")
"""Routes whose bytes the daemon receives itself; by the others it receives a message on the bus."""
START_TIME = 120.0
END_TIME = 10.0
SITE = "lab"

Press = Callable[[], Awaitable[object]]


@asynccontextmanager
async def stoppable_cell(
    folder: Path, environment: Mapping[str, str]
) -> AsyncIterator[tuple[RunningCell, Mapping[str, Press]]]:
    """Start a cell, and yield it with a function for each route that presses Stop.

    Args:
        folder: Folder for all files.
        environment: Environment variables of daemon and nodes in addition to those of this process.
    """
    endpoint, key, name, now = f"tls/127.0.0.1:{free_port()}", folder / "panel.key", folder.name, SystemClock().wall()
    new_key(key)
    authority = Authority.init(folder / "pki", SITE, now)
    authority.issue("router", "gate", now, hosts=("127.0.0.1",), cells=("lab/*",), into=folder)
    authority.issue("daemon", "daemon1", now, cells=(f"{SITE}/*",), into=folder)
    authority.issue("operator", "far", now, cells=(f"{SITE}/*",), via=("gate",), into=folder)
    register = authority.folder / "register.json"
    access = (
        f"access.identity={folder / 'daemon1'}",
        f"access.register={register}",
        f'access.routers=["{endpoint}"]',
        f"gateway.peers.panel.key_file={key}",
    )
    async with AsyncExitStack() as stack:
        router = ("--identity", str(folder / "gate"), "--register", str(register), "--listen", endpoint)
        await stack.enter_async_context(_command("router", *router))
        cell = await stack.enter_async_context(open_cell(folder, (*REAL_TIME, *access), environment=environment))
        await stack.enter_async_context(cell.client.holding())
        own = ("--endpoint", cell.ready.endpoint, "--site", SITE, "--cell", name)
        line = await stack.enter_async_context(_command("console", "--port", "0", "--json", *own))
        page = await stack.enter_async_context(open_page(json.loads(line)["url"]))
        signing = Planner.open(*cell.ready.links["planner"], signer=Signer("panel", read_key(key)))
        panel = await stack.enter_async_context(await signing)
        credentials = read_credentials(folder / "far", now)
        far = await stack.enter_async_context(Client.connect(endpoint, SITE, name, credentials=credentials))
        yield (
            cell,
            {
                "udp": cell.planner.stop,
                "tcp": lambda: _by_tcp(cell),
                "zenoh": cell.client.stop,
                "console": page.stop,
                "signed": panel.stop,
                "remote": far.stop,
            },
        )


async def _by_tcp(cell: RunningCell) -> None:
    reader, writer = await asyncio.open_connection(*cell.ready.links["tcp"])
    writer.write(b"stop_now_xxxxxxx;")
    await writer.drain()
    await reader.read(64)
    writer.close()


@asynccontextmanager
async def _command(name: str, *words: str) -> AsyncIterator[str]:
    """Run a command of ``pcmrs`` for the length of the context; yield its first line."""
    command = (sys.executable, "-m", "pcmrs.cli", name, *words)
    process = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
    try:
        assert process.stdout is not None
        async with asyncio.timeout(START_TIME):
            line = await process.stdout.readline()
        if not line:
            raise RuntimeError(f"pcmrs {name} has ended; see the reason on standard error.")
        yield line.decode()
    finally:
        if process.returncode is None:
            process.terminate()
        await end_child(process, END_TIME)
