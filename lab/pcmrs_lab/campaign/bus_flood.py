"""Floods of the bus by somebody who may only watch, from a process of its own: whoever measures is not who floods.

Each kind is what a single user sends. The user has no lease, and needs no role but to be let onto the bus.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Final, Literal, get_args

import zenoh

from pcmrs.bus.codec import pack, unpack
from pcmrs.bus.commands import Envelope
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import REQUESTS
from pcmrs.bus.requests import send_query
from pcmrs.bus.settings import BusSettings, open_session
from pcmrs.bus.stop import Stopping
from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.messages import Verdict
from pcmrs_lab.campaign.sham import is_sham

Kind = Literal["setup", "journal", "stop-puts", "stop-names", "stop-queries", "puts", "rejected"]
KINDS: tuple[Kind, ...] = get_args(Kind)
AT_ONCE: Final = 100
"""Requests that wait for their reply at the same time."""
BURST: Final = 1_000
"""Puts between two turns of the flooding process."""
NAMES: Final = 10_000
"""Different names under which one process puts Stops."""
LONG: Final = 60_000
"""Bytes of the arguments of a rejected command."""
PATIENCE: Final = 10.0
FLOODER: Final = "eve"


@dataclass(frozen=True, slots=True)
class Told:
    """What a flood has done.

    Attributes:
        sent: Messages.
        seconds: For how long.
        answered: Requests that were answered, whatever the answer was.
        codes: Answers by what they say: the reason of a rejection or error, or ``accepted``.
    """

    sent: int = 0
    seconds: float = 0.0
    answered: int = 0
    codes: dict[str, int] | None = None

    @property
    def rate(self) -> float:
        """Messages per second."""
        return self.sent / self.seconds if self.seconds else 0.0


class Flooding:
    """A flood that runs; `told` is complete once its context has ended."""

    def __init__(self) -> None:
        self.told = Told()


@asynccontextmanager
async def bus_flood(
    kind: Kind, endpoint: str, cell: str, *, user: str = FLOODER, most: int = 0
) -> AsyncIterator[Flooding]:
    """Floods the bus of a cell for the length of the context.

    Args:
        kind: What is sent.
        endpoint: Of the bus.
        cell: Name of the cell.
        user: In the keys.
        most: Ends by itself after so many messages; 0 for never.

    Raises:
        DeviceError: It does not begin.
    """
    if is_sham():
        yield Flooding()
        return
    words = [kind, "--endpoint", endpoint, "--cell", cell, "--user", user, "--most", str(most)]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *words, stdin=pipe, stdout=pipe)
    reader, writer = process.stdout, process.stdin
    if reader is None or writer is None or not await reader.readline():
        raise DeviceError(f"The flood of {kind} does not begin.")
    flooding = Flooding()
    try:
        if most:
            flooding.told = Told(**json.loads(await reader.readline()))
        yield flooding
    finally:
        writer.close()
        line = b"" if most else await reader.readline()
        await process.wait()
        if line:
            flooding.told = Told(**json.loads(line))


class _Flood:
    def __init__(self, kind: Kind, settings: BusSettings, user: str, most: int) -> None:
        self._prefix = cell_prefix(settings.site, settings.cell)
        self._session = open_session(settings)
        self._pool = ThreadPoolExecutor(4)
        self._user = user
        self._most = most
        self._ended = asyncio.Event()
        self._sent = self._answered = 0
        self._codes: dict[str, int] = {}
        self._run: Callable[[], Awaitable[object]] = {
            "setup": lambda: self._ask(f"svc/setup/{user}", b""),
            "journal": lambda: self._ask("svc/journal", b'{"limit": 500}'),
            "stop-puts": lambda: self._put([f"stop/{user}"]),
            "stop-names": lambda: self._put([f"stop/{user}{number}" for number in range(NAMES)]),
            "puts": lambda: self._put([f"cmd/{user}/toolplan/plan"]),
            "stop-queries": lambda: self._ask(f"stop/{user}", b""),
            "rejected": lambda: self._ask(f"cmd/{user}/toolplan/plan", pack(Envelope(arguments={"text": "x" * LONG}))),
        }[kind]

    def end(self) -> None:
        self._ended.set()

    @property
    def _on(self) -> bool:
        return not self._ended.is_set() and (not self._most or self._sent < self._most)

    async def run(self) -> Told:
        began = time.monotonic()
        await self._run()
        taken = time.monotonic() - began
        await asyncio.to_thread(self._session.close)  # what is still on its way is sent before it ends
        return Told(self._sent, taken, self._answered, self._codes)

    async def _put(self, names: list[str]) -> None:
        keys = [f"{self._prefix}/{name}" for name in names]
        while self._on:
            await asyncio.to_thread(self._burst, keys)

    def _burst(self, keys: list[str]) -> None:
        many = min(BURST, self._most - self._sent) if self._most else BURST
        for number in range(self._sent, self._sent + many):
            self._session.put(keys[number % len(keys)], b"", congestion_control=zenoh.CongestionControl.BLOCK)
        self._sent += many

    async def _ask(self, key: str, payload: bytes) -> None:
        async with asyncio.TaskGroup() as tasks:
            for _ in range(AT_ONCE):
                tasks.create_task(self._ask_on(f"{self._prefix}/{key}", payload))

    async def _ask_on(self, key: str, payload: bytes) -> None:
        while self._on:
            self._sent += 1
            try:
                answer = await send_query(self._session, self._pool, key, payload, PATIENCE, REQUESTS)
                code = _said(answer)
            except PcmrsError as error:
                code = str(error.fields.get("reason", error.code))
            self._codes[code] = self._codes.get(code, 0) + 1
            self._answered += code != "unknown_outcome"


def _said(answer: bytes) -> str:
    for kind in (Verdict, Stopping):
        try:
            read = unpack(answer, kind)
        except PcmrsError:
            continue
        if isinstance(read, Verdict) and read.reason is not None:
            return read.reason.code
        return "accepted"
    return "answered"


def main() -> None:
    """Floods until standard input ends; prints what was done as one line of JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--endpoint", required=True)
    parser.add_argument("--cell", required=True)
    parser.add_argument("--user", default=FLOODER)
    parser.add_argument("--most", type=int, default=0)
    given = parser.parse_args()
    asyncio.run(_flood(given))


async def _flood(given: argparse.Namespace) -> None:
    flood = _Flood(given.kind, BusSettings(endpoint=given.endpoint, cell=given.cell), given.user, given.most)
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), flood.end)
    _say("begun")
    told = await flood.run()
    asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
    _say(json.dumps({"sent": told.sent, "seconds": told.seconds, "answered": told.answered, "codes": told.codes}))


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
