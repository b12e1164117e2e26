"""Flood of connections from a separate process: each is opened, with TLS if asked for, and closed."""

from __future__ import annotations

import argparse
import asyncio
import json
import select
import socket
import ssl
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

from pcmrs.errors import DeviceError
from pcmrs_lab.campaign.sham import is_sham

CONNECTED_WITHIN = 1.0
"""Time limit for one connection and its handshake, s."""


@dataclass
class ConnectionFlood:
    """Result of a flood; complete when its context has ended.

    Attributes:
        connections: Number of connections that were tried.
        seconds: Duration, s.
    """

    connections: int = 0
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Connections per second."""
        return self.connections / self.seconds if self.seconds else 0.0


@asynccontextmanager
async def connection_flood(address: tuple[str, int], *, tls: bool = False) -> AsyncIterator[ConnectionFlood]:
    """Open connections one after the other for the length of the context.

    Args:
        address: Host and port.
        tls: True for a TLS handshake without a certificate on each.

    Raises:
        DeviceError: The flooding process does not start.
    """
    result = ConnectionFlood()
    if is_sham():
        yield result
        return
    words = [f"{address[0]}:{address[1]}", *(["--tls"] if tls else [])]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *words, stdin=pipe, stdout=pipe)
    reader, writer = process.stdout, process.stdin
    if reader is None or writer is None or not await reader.readline():
        raise DeviceError("The flood of connections did not start.")
    try:
        yield result
    finally:
        writer.close()
        line = await reader.readline()
        await process.wait()
        if line:
            result.connections, result.seconds = json.loads(line)


def main() -> None:
    """Flood until standard input ends, and print number and duration as one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("--tls", action="store_true")
    given = parser.parse_args()
    host, _, port = given.address.rpartition(":")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT) if given.tls else None
    if context is not None:
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    sys.stdout.write("begun\n")
    sys.stdout.flush()
    count, started = 0, time.monotonic()
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        with suppress(OSError):
            _connect((host, int(port)), context)
        count += 1
    sys.stdout.write(json.dumps([count, time.monotonic() - started]) + "\n")


def _connect(address: tuple[str, int], context: ssl.SSLContext | None) -> None:
    with socket.create_connection(address, timeout=CONNECTED_WITHIN) as opened:
        if context is not None:
            context.wrap_socket(opened).close()


if __name__ == "__main__":
    main()
