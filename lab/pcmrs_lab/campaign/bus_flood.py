"""Floods of the bus by a user who may only watch, from a separate process that does not distort measurements.

Each kind is traffic that a single user sends. The user has no lease, and needs no role, only access to the bus.
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
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import TeleopSetpoint, Verdict
from pcmrs.messages.teleop import AT_REST
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import COMMANDS, DEVICES, FLOODING, QUERIES, SETPOINTS, STOP, STREAMS, record

Kind = Literal[
    "setup", "journal", "check", "stop-puts", "stop-names", "stop-queries", "puts", "rejected", "rejected-names",
    "rejected-keys", "setpoints", "devices", "streams",
]  # fmt: skip
KINDS: tuple[Kind, ...] = get_args(Kind)
PARALLEL_REQUESTS: Final = 100
"""Number of requests that wait for their reply at the same time."""
BURST_SIZE: Final = 1_000
"""Number of puts before the flooding process lets its event loop run."""
STOP_NAMES: Final = 10_000
"""Number of different names under which one process puts Stops."""
ARGUMENT_SIZE: Final = 60_000
"""Size of what a rejected command repeats, bytes: the value or name of an argument, or an operation in its key."""
REPLY_TIMEOUT: Final = 10.0
"""Time limit for a reply, s of the machine."""
FLOODER: Final = "eve"
_LONG: Final = "x" * ARGUMENT_SIZE
CHECKED: Final = b'{"branch": "toolplan", "operation": "plan"}'
SETPOINT: Final = pack(TeleopSetpoint(sequence=1, sent=0.0, seen=0.0, ttl=1.0, twist=AT_REST))
WAYS: Final[dict[Kind, str]] = {
    "setup": QUERIES, "journal": QUERIES, "check": QUERIES, "stop-puts": STOP, "stop-names": STOP, "stop-queries": STOP,
    "puts": COMMANDS, "rejected": COMMANDS, "rejected-names": COMMANDS,
    "rejected-keys": COMMANDS, "setpoints": SETPOINTS, "devices": DEVICES, "streams": STREAMS,
}  # fmt: skip
"""Entry point that each kind floods."""


@dataclass(frozen=True, slots=True)
class FloodReport:
    """Result of a flood.

    Attributes:
        sent: Number of messages that were sent.
        seconds: Duration, s.
        answered: Number of requests that were answered, with any result.
        codes: Number of answers by result: the reason of a rejection or error, or ``accepted``.
    """

    sent: int = 0
    seconds: float = 0.0
    answered: int = 0
    codes: dict[str, int] | None = None

    @property
    def rate(self) -> float:
        """Messages per second."""
        return self.sent / self.seconds if self.seconds else 0.0


class BusFlood:
    """Running flood; `report` is complete when its context has ended."""

    def __init__(self) -> None:
        self.report = FloodReport()


@asynccontextmanager
async def bus_flood(
    kind: Kind, endpoint: str, cell: str, *, user: str = FLOODER, most: int = 0
) -> AsyncIterator[BusFlood]:
    """Flood the bus of a cell for the length of the context.

    Args:
        kind: Kind of traffic.
        endpoint: Zenoh endpoint of the bus.
        cell: Name of the cell.
        user: Name of the sender in the keys.
        most: Number of messages after which the flood ends by itself; 0 for no limit.

    Raises:
        DeviceError: The flooding process does not start.
    """
    if is_sham():
        yield BusFlood()
        return
    words = [kind, "--endpoint", endpoint, "--cell", cell, "--user", user, "--most", str(most)]
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(sys.executable, "-m", __name__, *words, stdin=pipe, stdout=pipe)
    reader, writer = process.stdout, process.stdin
    if reader is None or writer is None or not await reader.readline():
        raise DeviceError(f"The flood of {kind} did not start.")
    record(FLOODING, WAYS[kind])
    flooding = BusFlood()
    try:
        if most:
            flooding.report = FloodReport(**json.loads(await reader.readline()))
        yield flooding
    finally:
        writer.close()
        line = b"" if most else await reader.readline()
        await process.wait()
        if line:
            flooding.report = FloodReport(**json.loads(line))


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
            "setup": lambda: self._query_in_parallel(f"svc/setup/{user}", b""),
            "journal": lambda: self._query_in_parallel("svc/journal", b'{"limit": 500}'),
            "check": lambda: self._query_in_parallel(f"svc/check/{user}", CHECKED),
            "stop-puts": lambda: self._put_in_bursts([f"stop/{user}"]),
            "stop-names": lambda: self._put_in_bursts([f"stop/{user}{number}" for number in range(STOP_NAMES)]),
            "puts": lambda: self._put_in_bursts([f"cmd/{user}/toolplan/plan"]),
            "setpoints": lambda: self._put_in_bursts([f"teleop/{user}"], SETPOINT),
            "devices": lambda: self._put_in_bursts(["dev/robot/event", "dev/robot/beat"]),
            "streams": lambda: self._put_in_bursts(["state/joints", "state/pose/coil"]),
            "stop-queries": lambda: self._query_in_parallel(f"stop/{user}", b""),
            "rejected": lambda: self._query_in_parallel(
                f"cmd/{user}/toolplan/plan", pack(Envelope(arguments={"text": _LONG}))
            ),
            "rejected-names": lambda: self._query_in_parallel(
                f"cmd/{user}/toolplan/plan", pack(Envelope(arguments={_LONG: 1}))
            ),
            "rejected-keys": lambda: self._query_in_parallel(f"cmd/{user}/toolplan/{_LONG}", b""),
        }[kind]

    def end(self) -> None:
        self._ended.set()

    @property
    def _is_active(self) -> bool:
        return not self._ended.is_set() and (not self._most or self._sent < self._most)

    async def run(self) -> FloodReport:
        began = time.monotonic()
        await self._run()
        taken = time.monotonic() - began
        await asyncio.to_thread(self._session.close)  # closing flushes the messages that Zenoh still queues
        return FloodReport(self._sent, taken, self._answered, self._codes)

    async def _put_in_bursts(self, names: list[str], payload: bytes = b"") -> None:
        keys = [f"{self._prefix}/{name}" for name in names]
        while self._is_active:
            await asyncio.to_thread(self._burst, keys, payload)

    def _burst(self, keys: list[str], payload: bytes) -> None:
        many = min(BURST_SIZE, self._most - self._sent) if self._most else BURST_SIZE
        for number in range(self._sent, self._sent + many):
            self._session.put(keys[number % len(keys)], payload, congestion_control=zenoh.CongestionControl.BLOCK)
        self._sent += many

    async def _query_in_parallel(self, key: str, payload: bytes) -> None:
        async with asyncio.TaskGroup() as tasks:
            for _ in range(PARALLEL_REQUESTS):
                tasks.create_task(self._query_repeatedly(f"{self._prefix}/{key}", payload))

    async def _query_repeatedly(self, key: str, payload: bytes) -> None:
        while self._is_active:
            self._sent += 1
            try:
                answer = await send_query(self._session, self._pool, key, payload, REPLY_TIMEOUT, REQUESTS)
                code = _outcome_of(answer)
            except PcmrsError as error:
                code = str(error.fields.get("reason", error.code))
            self._codes[code] = self._codes.get(code, 0) + 1
            self._answered += code != UnknownOutcomeError.code


def _outcome_of(answer: bytes) -> str:
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
    """Flood until standard input ends and print what was done as one line of JSON."""
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
    # The end of standard input stops the flood, so that it never outlives the process that started it.
    asyncio.get_running_loop().add_reader(sys.stdin.fileno(), flood.end)
    _print_line("begun")
    report = await flood.run()
    asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
    _print_line(
        json.dumps({"sent": report.sent, "seconds": report.seconds, "answered": report.answered, "codes": report.codes})
    )


def _print_line(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
