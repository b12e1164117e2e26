"""The required responses as checks: what is seen instead is said in `Unmet`."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

import msgspec

from pcmrs.gateway.rejection_log import REFUSED
from pcmrs.journal import JournalRow
from pcmrs.messages import JointState, Snapshot, Verdict
from pcmrs.testing.driving import PATIENCE, accept, reason_text, until
from pcmrs.testing.errors import Unmet

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell

STANDS_WITHIN = 2e-4
"""An arm that has gone less than this during `LOOK` stands, m; the simulated one is held by its brakes."""

LOOK = 0.5
BRAKING = 1.0
"""Any motion has ended so long after it was stopped, s of the machine."""

NO_MOTION = 2e-3
"""A joint that has gone less than this was not moved, rad."""


def shape(snapshot: Snapshot) -> bytes:
    """What of a snapshot must not change: all but what activities show of themselves, and what runs."""
    return msgspec.json.encode(msgspec.structs.replace(snapshot, running=[], activities=[]))


async def refused(
    cell: RunningCell, name: str, arguments: dict[str, Any] | None = None, *, codes: Iterable[str]
) -> Verdict:
    """Response R: a command is rejected with one of `codes`, nothing has changed, and the journal has it.

    Raises:
        Unmet: It was not so.
    """
    before, row = await cell.client.state(), cell.last_row()
    verdict = await cell.client.call(name, arguments)
    await check_refused(cell, verdict, before, row, codes)
    return verdict


async def refused_at_edge(cell: RunningCell, name: str, arguments: dict[str, Any], *, code: str) -> None:
    """A command that is none is rejected by the bus with `code`, and nothing has changed; see `reported`.

    Raises:
        Unmet: It was not so.
    """
    before = await cell.client.state()
    verdict = await cell.client.call(name, arguments)
    await _check_rejected(cell, verdict, before, [code])


async def reported(cell: RunningCell, after: int, *, edge: str, code: str, count: int) -> int:
    """The journal's reports of what an edge has refused with `code` come to `count`, which is returned.

    They come at a bounded rate.

    Raises:
        Unmet: They did not within `PATIENCE`.
    """
    found = 0
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            while True:
                found = sum(_refused_by(row, edge, code) for row in cell.rows(after))
                if found == count:
                    return found
                await asyncio.sleep(0.5)
    raise Unmet(f"The journal tells of {found} commands that the {edge} has refused as {code}, not {count}.")


def _refused_by(row: JournalRow, edge: str, code: str) -> int:
    fields = (row.result or {}).get("fields", {})
    is_one = (row.kind, row.source, row.operation) == ("device", edge, REFUSED) and fields.get("reason") == code
    return int(fields["count"]) if is_one else 0


async def check_refused(cell: RunningCell, verdict: Verdict, before: Snapshot, row: int, codes: Iterable[str]) -> None:
    """Checks response R of a verdict: `before` and `row` are snapshot and last row of the journal before the command.

    Raises:
        Unmet: It was not refused so, something changed, or the journal does not have it.
    """
    await _check_rejected(cell, verdict, before, codes)
    if not any(stored.verdict == verdict for stored in cell.rows(row)):
        what = f"{verdict.branch}.{verdict.operation}"
        raise Unmet(f"{what} was rejected, but the journal has no row of it.")


async def _check_rejected(cell: RunningCell, verdict: Verdict, before: Snapshot, codes: Iterable[str]) -> None:
    what, known = f"{verdict.branch}.{verdict.operation}", list(codes)
    if verdict.decision != "rejected" or verdict.reason is None or verdict.reason.code not in known:
        raise Unmet(f"{what} was {verdict.decision} ({reason_text(verdict)}), must be rejected: {', '.join(known)}.")
    after = await cell.client.state()
    if shape(after) != shape(before):
        raise Unmet(f"{what} was rejected, but the state changed: {before} became {after}.")


async def held(cell: RunningCell, placements: Iterable[str] = ("held",), within: float = PATIENCE) -> None:
    """Response H: the tool is held, the latch is set, the arm truly stands, and it does not move until confirmed.

    Args:
        cell: Whose.
        placements: States of the placement, one of which it must be in.
        within: By then it is so, s of the machine.

    Raises:
        Unmet: It was not so.
    """
    known = tuple(placements)
    await until(cell.client, lambda shown: shown.latched and shown.branches["placement"] in known, within)
    await stands(cell)
    if (await cell.client.state()).branches["placement"] == "held":
        await refused(cell, "placement.back_off", codes=("latched",))


async def stands(cell: RunningCell) -> float:
    """Checks by the simulation's truth that the arm stands; returns how far it went during `LOOK`, m.

    Raises:
        Unmet: It moves.
    """
    await asyncio.sleep(BRAKING)
    before = await tool_position(cell)
    await asyncio.sleep(LOOK)
    return await _still_at(before, cell)


@asynccontextmanager
async def unmoved(cell: RunningCell) -> AsyncIterator[None]:
    """Checks by the simulation's truth that an arm at rest is after `LOOK` where it was when the context began.

    Raises:
        Unmet: It is not.
    """
    before = await tool_position(cell)
    yield
    await asyncio.sleep(LOOK)
    await _still_at(before, cell)


@asynccontextmanager
async def standing(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Checks by all published joints that none moves during the context, and a second after it.

    Yields:
        Where the largest displacement is put at the end, rad.

    Raises:
        Unmet: One has moved, or none was published.
    """
    found: list[float] = []
    seen: list[tuple[float, ...]] = []
    end = cell.client.listen("state/joints", JointState, lambda joints: seen.append(tuple(joints.positions)))
    try:
        yield found
        await asyncio.sleep(BRAKING)
    finally:
        await end()
    if len(seen) < 2:
        raise Unmet("The arm's joints were not published.")
    found.append(max(abs(now - begun) for joints in seen for now, begun in zip(joints, seen[0], strict=True)))
    if found[0] > NO_MOTION:
        raise Unmet(f"A joint has moved by {math.degrees(found[0]):.1f}° while nothing may move.")


async def tool_position(cell: RunningCell) -> tuple[float, float, float]:
    """Where the tool truly is, in the tracker's frame, m."""
    return (await cell.scene.truth()).tracker_from_coil.position


async def _still_at(before: tuple[float, float, float], cell: RunningCell) -> float:
    way = math.dist(before, await tool_position(cell))
    if way > STANDS_WITHIN:
        raise Unmet(f"The arm has moved by {way * 1e3:.2f} mm.")
    return way


async def confirmed(cell: RunningCell) -> None:
    """Nothing went on by itself; after the operator has confirmed, the tool can be withdrawn.

    Raises:
        Unmet: The latch was gone, or confirming or withdrawing was not accepted.
    """
    if not (await cell.client.state()).latched:
        raise Unmet("The latch is gone, and nobody has confirmed.")
    await accept(cell.client, "robot.acknowledge")
    if (await cell.client.state()).branches["placement"] == "held":
        await accept(cell.client, "placement.back_off")


def expect(truth: bool, text: str) -> None:
    """Raises `Unmet` with the text unless it is so."""
    if not truth:
        raise Unmet(text)
