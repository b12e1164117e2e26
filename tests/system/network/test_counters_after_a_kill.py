"""Counters of signed peers, with a daemon that is killed."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from tests import ROOT
from tests.unit.gateway.gateway_fakes import UdpClient
from tests.unit.gateway.signed_room import peer, signer

DAEMON = """
import asyncio, json, sys
from pathlib import Path

import structlog

structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
sys.path.insert(0, sys.argv[2])
from pcmrs.testing.clock import ManualClock
from tests.unit.gateway.gateway_fakes import FakeCore
from tests.unit.gateway.signed_room import config, peer
from pcmrs.gateway.links import open_gateway

async def serve(folder):
    async with open_gateway(FakeCore(), config({"planner": peer(folder, "planner")}), ManualClock(), folder) as gateway:
        print(json.dumps(gateway.addresses["planner"]), flush=True)
        await asyncio.Event().wait()

asyncio.run(serve(Path(sys.argv[1])))
"""


@asynccontextmanager
async def daemon(folder: Path) -> AsyncIterator[tuple[str, int]]:
    """The planner link of a daemon in a process of its own, killed in the end."""
    words = (sys.executable, "-c", DAEMON, folder, ROOT)
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    assert process.stdout is not None
    try:
        host, port = json.loads(await process.stdout.readline())
        yield host, port
    finally:
        process.kill()
        await process.wait()


async def test_answered_command_is_refused_after_a_kill(tmp_path: Path) -> None:
    peer(tmp_path, "planner")
    ours = signer(tmp_path, "planner")
    sent: list[bytes] = []
    for run in range(3):
        client = await UdpClient.open()
        async with daemon(tmp_path) as address:
            for datagram in sent:
                client.send(datagram, address)
            for number in range(10):
                sent.append(ours.sign(f"rob_conn_onxxxxx_#{100 * run + number};".encode()))
                client.send(sent[-1], address)
                # Replays would have been answered first: datagrams of one socket stay in order.
                assert (await client.received.get()).startswith(f"{100 * run + number}_accepted")
        assert client.received.empty()
        client.transport.close()
