"""Many datagrams a second from a process of its own, so that who measures is not who floods."""

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

BURST = 0.002
"""Datagrams are sent in bursts of so many seconds, so that the sender mostly sleeps."""

BATCH = 64
"""Without a rate, so many are sent between two looks at the answers."""

STORE = 4096
"""Different datagrams of a flood."""


@dataclass
class FloodResult:
    """What a flood has sent, once it has ended; `ended` is set when it has by itself."""

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
    """Floods a UDP socket for the length of the context.

    Args:
        address: Of the socket.
        rate: Datagrams per second; 0 for as many as can be sent.
        seed: Of what they hold.
        most: Ends by itself after so many; 0 for never.

    Yields:
        What was sent; complete when the context has ended.

    Raises:
        DeviceError: It does not begin.
    """
    if is_sham():
        yield FloodResult()
        return
    words = [f"{address[0]}:{address[1]}", "--rate", str(rate), "--seed", str(seed), "--most", str(most)]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *words, stdin=pipe, stdout=pipe)
    reader, writer = process.stdout, process.stdin
    if reader is None or writer is None or not await reader.readline():
        raise DeviceError("The flood does not begin.")
    sent = FloodResult()
    telling = asyncio.create_task(_told(reader, sent))
    try:
        yield sent
    finally:
        writer.close()
        await telling
        await process.wait()


async def _told(reader: asyncio.StreamReader, sent: FloodResult) -> None:
    line = await reader.readline()
    if line:
        told = json.loads(line)
        sent.datagrams, sent.seconds, sent.answers = told["datagrams"], told["seconds"], told["answers"]
    sent.ended.set()


def main() -> None:
    """Floods until standard input ends; prints what was sent as one line of JSON."""
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
        _say("begun")
        count, answers, seconds = _send(sender, store, generator, given.rate, given.most)
    _say(json.dumps({"datagrams": count, "answers": answers, "seconds": seconds}))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _send(
    sender: socket.socket, store: list[bytes], generator: random.Random, rate: float, most: int
) -> tuple[int, int, float]:
    """Sends until standard input ends or there were enough: how many, the answers, and the seconds."""
    begun, count, answers = time.monotonic(), 0, 0
    while not most or count < most:
        due = int((time.monotonic() - begun) * rate) if rate else count + BATCH
        due = min(due, most) if most else due
        for number in range(count, due):
            with suppress(OSError):
                sender.send(store[number % len(store)])
        if most:  # what is counted is to be different each time
            for number in range(count, due):
                store[number % len(store)] = datagram(generator)
        count = max(count, due)
        with suppress(OSError):
            while sender.recv(65536):
                answers += 1
        ended, _, _ = select.select([sys.stdin], [], [], BURST if rate else 0.0)
        if ended:
            break
    return count, answers, time.monotonic() - begun


if __name__ == "__main__":
    main()
