"""Flood of datagrams from a separate process, so that the load does not distort measurements."""

from __future__ import annotations

import argparse
import asyncio
import json
import random
import select
import socket
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

from pcmrs.errors import DeviceError
from pcmrs_lab.campaign.fuzz import datagram
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import FLOODING, record

BURST = 0.002
"""Time between bursts of datagrams, s, so that the sender mostly sleeps."""

BATCH = 64
"""Number of datagrams between two reads of the answers if there is no rate."""

STORE = 4096
"""Number of different datagrams of a flood."""


@dataclass
class FloodResult:
    """Result of a flood; complete when it has ended.

    Attributes:
        ended: Set when the flood has ended by itself.
    """

    datagrams: int = 0
    seconds: float = 0.0
    answers: int = 0
    ended: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def rate(self) -> float:
        """Datagrams per second."""
        return self.datagrams / self.seconds if self.seconds else 0.0


@asynccontextmanager
async def flood(address: tuple[str, int], rate: float, seed: int, *, most: int = 0) -> AsyncIterator[FloodResult]:
    """Flood a UDP socket for the length of the context.

    Args:
        address: Host and port of the socket.
        rate: Datagrams per second; 0 for as many as possible.
        seed: Seed of the contents.
        most: Number after which the flood ends by itself; 0 for no limit.

    Yields:
        Result, complete when the context has ended.

    Raises:
        DeviceError: The flooding process does not start.
    """
    if is_sham():
        yield FloodResult()
        return
    words = [f"{address[0]}:{address[1]}", "--rate", str(rate), "--seed", str(seed), "--most", str(most)]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *words, stdin=pipe, stdout=pipe)
    reader, writer = process.stdout, process.stdin
    if reader is None or writer is None or not await reader.readline():
        raise DeviceError("The flood did not start.")
    record(FLOODING, "UDP")
    sent = FloodResult()
    reading = asyncio.create_task(_read_report(reader, sent))
    try:
        yield sent
    finally:
        writer.close()
        await reading
        await process.wait()


async def _read_report(reader: asyncio.StreamReader, sent: FloodResult) -> None:
    line = await reader.readline()
    if line:
        report = json.loads(line)
        sent.datagrams, sent.seconds, sent.answers = report["datagrams"], report["seconds"], report["answers"]
    sent.ended.set()


def main() -> None:
    """Flood until standard input ends and print what was sent as one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("address")
    parser.add_argument("--rate", type=float, default=0.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most", type=int, default=0)
    given = parser.parse_args()
    host, _, port = given.address.rpartition(":")
    generator = random.Random(given.seed)
    store = [datagram(generator) for _ in range(STORE)]
    with socket.socket(type=socket.SOCK_DGRAM) as sender:
        sender.connect((host, int(port)))
        sender.setblocking(False)
        _print_line("begun")
        count, answers, seconds = _send(sender, store, generator, given.rate, given.most)
    _print_line(json.dumps({"datagrams": count, "answers": answers, "seconds": seconds}))


def _print_line(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _send(
    sender: socket.socket, store: list[bytes], generator: random.Random, rate: float, most: int
) -> tuple[int, int, float]:
    """Send until standard input ends or the limit is reached; return numbers of datagrams and answers, and s."""
    started, count, answers = time.monotonic(), 0, 0
    while not most or count < most:
        due = int((time.monotonic() - started) * rate) if rate else count + BATCH
        due = min(due, most) if most else due
        for number in range(count, due):
            with suppress(OSError):
                sender.send(store[number % len(store)])
        if most:  # counted datagrams must all be different
            for number in range(count, due):
                store[number % len(store)] = datagram(generator)
        count = max(count, due)
        with suppress(OSError):
            while sender.recv(65536):
                answers += 1
        ended, _, _ = select.select([sys.stdin], [], [], BURST if rate else 0.0)
        if ended:
            break
    return count, answers, time.monotonic() - started


if __name__ == "__main__":
    main()
