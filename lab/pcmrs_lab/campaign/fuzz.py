"""Millions of malformed commands at a daemon's UDP socket: made by the grammar, changed at one place, or random."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from pathlib import Path

import msgspec

from pcmrs.clock import Clock
from pcmrs.errors import PcmrsError
from pcmrs.gateway.commands import COMMANDS, Action, Spec, TokenType
from pcmrs.gateway.grammar import NAME_LENGTH
from pcmrs.testing.cell import RunningCell, open_cell
from pcmrs.testing.driving import digitize_landmarks
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import shape
from pcmrs_lab.campaign.datagrams import raw_socket
from pcmrs_lab.campaign.samples import sample

HARMLESS = (Action.STOP_TIP, Action.STOP_POSES)
"""Actions that a well-formed datagram may request: they change no state in any situation."""

RIGHT = {TokenType.COUNT: "01", TokenType.NUMBER: "0.1", TokenType.PATH: "surface.ply"}
WRONG = {
    TokenType.COUNT: ("1000", "-1", "+1", "٣", "1.0", "", "nan", "0x1"),
    TokenType.NUMBER: ("nan", "-nan", "inf", "1e999", "-1e999", "1_000", "0x1p3", "+", ".", "1e", "١", "", "1,5", " 1"),
    TokenType.PATH: ("", "a" * 300, "a;b", "\n", "é"),
}
"""Valid token of each kind (`RIGHT`), and invalid ones."""
SIGNATURE = b"|peer|1|" + b"0" * 32
STRAYS = (b"\0", b"\n", b"\xff", b";", b";;", b"_#", b"_#12345678901", b"quit", b"exit")


def datagram(generator: random.Random) -> bytes:
    """Return one random datagram; none has an effect on a cell in any state."""
    kind = generator.random()
    if kind < 0.1:
        return generator.randbytes(generator.choice((0, 1, 16, 17, 255, 256, 257, 1400)))
    spec = generator.choice(list(COMMANDS.values()))
    if spec.payload and kind < 0.5:
        return _invalid_payload(spec, generator)
    whole = _command(spec, [RIGHT[each] for each in spec.payload], generator)
    return whole if kind < 0.6 and spec.action in HARMLESS else _malformed(whole, generator)


def _invalid_payload(spec: Spec, generator: random.Random) -> bytes:
    """Return a command with one invalid token, one token too few, or one too many."""
    tokens = [RIGHT[kind] for kind in spec.payload]
    place, way = generator.randrange(len(tokens)), generator.random()
    if way < 0.1:
        return _command(spec, tokens[:-1], generator)
    if way < 0.2 and spec.payload != (TokenType.PATH,):
        return _command(spec, [*tokens, "0.1"], generator)
    tokens[place] = generator.choice(WRONG[spec.payload[place]])
    return _command(spec, tokens, generator)


def _command(spec: Spec, tokens: list[str], generator: random.Random) -> bytes:
    if generator.random() < 0.3:
        tokens = [*tokens, f"#{generator.randrange(10**9)}"]
    return ("_".join([spec.name, *tokens]) + ";").encode()


def _malformed(whole: bytes, generator: random.Random) -> bytes:
    """Return the command with a fault in its name or after its end, so that the grammar has no such command."""
    place, way = generator.randrange(NAME_LENGTH), generator.randrange(7)
    if way == 0:
        return whole[:place] + bytes([generator.choice(b"@~ \x00\xff")]) + whole[place + 1 :]
    if way == 1:
        return whole[: generator.randrange(len(whole))].rstrip(b";")
    if way == 2:
        return whole + generator.choice(STRAYS) + b"!"
    if way == 3:
        return whole[:place] + whole[place + 1 :]
    if way == 4:
        return whole + SIGNATURE
    if way == 5:
        return whole[:NAME_LENGTH] + b"!" + whole[NAME_LENGTH:]
    return whole.replace(b";", b"") + b"_" * generator.randrange(300)


WINDOW = 100
"""Number of datagrams that are sent before their processing is awaited: as many as fit into a socket's buffer."""

WARM_UP = 50_000
"""Number of datagrams before memory is measured, so that caches and the allocator have settled."""

GROWTH_MB = 10.0
"""Limit for the growth of the daemon after that, MB."""

LOOKS = 10
BETWEEN = 0.3
"""Memory is the least of `LOOKS` measurements, this time apart (s of the machine), since a few MB may be about to be
freed."""

ShowProgress = Callable[[str, int, int], None]


class FuzzReport(msgspec.Struct, frozen=True):
    """Result of a fuzzed daemon.

    Attributes:
        datagrams: Number sent after the warm-up; the daemon processed all except the dropped ones.
        dropped: Number dropped by the kernel, warm-up included.
        answers: Number of answers.
        rate: Datagrams sent per second.
        crashed: The daemon has ended, or does not answer any more.
        state_changed: States or data differed at the end.
        rows: Number of commands that the journal received meanwhile.
        growth_mb: Growth of the daemon's memory since the warm-up, MB.
        seed: Seed of the contents.
        seconds: Duration, s of the machine.
    """

    datagrams: int
    dropped: int
    answers: int
    rate: float
    crashed: bool
    state_changed: bool
    rows: int
    growth_mb: float
    seed: int
    seconds: float

    @property
    def violated(self) -> bool:
        """True if the daemon crashed, executed anything, or grew."""
        return self.crashed or self.state_changed or self.rows > 0 or self.growth_mb >= GROWTH_MB


async def fuzz(
    datagrams: int,
    seed: int,
    folder: Path,
    clock: Clock,
    *,
    minutes: float | None = None,
    progress: ShowProgress = lambda *_: None,
) -> FuzzReport:
    """Send fuzzed datagrams to the planner's link of a daemon with digitized landmarks.

    Args:
        datagrams: Number of datagrams, after a warm-up of `WARM_UP`.
        seed: Seed of the contents.
        folder: Folder for the daemon; the caller removes it.
        clock: Clock of the machine.
        minutes: Time after which the run ends early, min.
        progress: Called after each window of datagrams.

    Returns:
        Result.
    """
    async with open_cell(folder / "fuzzed", ("robot.deadman=0.5",)) as cell:
        await digitize_landmarks(cell.client)
        generator, end = random.Random(seed), math.inf
        await _send(cell, WARM_UP, generator, end, clock, lambda *_: None)
        before, row, memory = await cell.client.state(), cell.last_row(), await _memory(cell, clock)
        started = clock.monotonic()
        if minutes is not None:
            end = started + minutes * 60.0
        sent, answers, alive = await _send(cell, datagrams, generator, end, clock, progress)
        seconds = clock.monotonic() - started
        alive = alive and await _answers(cell)
        return FuzzReport(
            datagrams=sent,
            dropped=dropped(cell.ready.links["planner"][1]),
            answers=answers,
            rate=sent / seconds,
            crashed=not alive,
            state_changed=alive and shape(await cell.client.state()) != shape(before),
            rows=sum(entry.kind in ("intent", "outcome") for entry in cell.rows(row)),
            growth_mb=(await _memory(cell, clock) - memory) / 1e6 if alive else 0.0,
            seed=seed,
            seconds=seconds,
        )


async def _send(
    cell: RunningCell, datagrams: int, generator: random.Random, end: float, clock: Clock, progress: ShowProgress
) -> tuple[int, int, bool]:
    """Send up to `datagrams` or until `end`; return how many were sent and answered, and if the daemon lives."""
    sent = answers = 0
    async with raw_socket(cell.ready.links["planner"]) as raw:
        while sent < datagrams and clock.monotonic() < end:
            for _ in range(min(WINDOW, datagrams - sent)):
                raw.send(datagram(generator))
                sent += 1
            try:
                answers += len(await raw.fence())
            except Unmet:
                return sent, answers, False
            progress("datagrams", sent, datagrams)
    return sent, answers, True


async def _memory(cell: RunningCell, clock: Clock) -> int:
    """Return the memory of the daemon, bytes."""
    looks = []
    for _ in range(LOOKS):
        looks.append(sample(cell.process.pid).memory)
        await clock.sleep(BETWEEN)
    return min(looks)


async def _answers(cell: RunningCell) -> bool:
    """Return whether the link still answers."""
    if cell.process.returncode is not None:
        return False
    try:
        async with raw_socket(cell.ready.links["planner"]) as raw:
            await raw.fence()
            await cell.client.state()
    except PcmrsError:
        return False
    return True


def dropped(port: int) -> int:
    """Return the number of datagrams that the kernel has dropped at the UDP sockets of a port."""
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(row[-1]) for row in rows if row[1].endswith(f":{port:04X}"))
