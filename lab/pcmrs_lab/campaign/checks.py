"""Checks of the required responses; a difference is reported as `Unmet`."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import msgspec

from pcmrs.gateway.rejection_log import REFUSED
from pcmrs.journal import JournalRow
from pcmrs.messages import Snapshot, Verdict
from pcmrs.testing.arm import stands
from pcmrs.testing.driving import PATIENCE, accept, reason_text, until
from pcmrs.testing.errors import Unmet

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


def shape(snapshot: Snapshot) -> bytes:
    """Return the part of a snapshot that must not change: everything except running operations and activities."""
    return msgspec.json.encode(msgspec.structs.replace(snapshot, running=[], activities=[]))


async def refused(
    cell: RunningCell, name: str, arguments: dict[str, Any] | None = None, *, codes: Iterable[str]
) -> Verdict:
    """Check response R: a command is rejected with one of `codes`, changes nothing, and is journalled.

    Args:
        cell: Cell that receives the command.
        name: Operation, ``branch.operation``.
        arguments: Arguments of the operation.
        codes: Permitted reason codes.

    Returns:
        Verdict of the rejection.

    Raises:
        Unmet: The command was not rejected like this.
    """
    before, row = await cell.client.state(), cell.last_row()
    verdict = await cell.client.call(name, arguments)
    await check_refused(cell, verdict, before, row, codes)
    return verdict


async def refused_at_edge(cell: RunningCell, name: str, arguments: dict[str, Any], *, code: str) -> None:
    """Check that the bus rejects a malformed command with `code` and that nothing has changed; see `reported`.

    Args:
        cell: Cell that receives the command.
        name: Operation, ``branch.operation``.
        arguments: Arguments of the operation.
        code: Required reason code.

    Raises:
        Unmet: The command was not rejected like this.
    """
    before = await cell.client.state()
    verdict = await cell.client.call(name, arguments)
    await _check_rejected(cell, verdict, before, [code])


async def reported(cell: RunningCell, after: int, *, edge: str, code: str, count: int) -> int:
    """Wait until the journal reports `count` commands that an edge has refused with `code`.

    The edges report refusals at a bounded rate.

    Args:
        cell: Cell with the journal.
        after: Sequence number after which rows count.
        edge: Source that reports, such as ``bus``.
        code: Reason code.
        count: Expected number.

    Returns:
        `count`.

    Raises:
        Unmet: The number was not reached within `PATIENCE`.
    """
    found = 0
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
            while True:
                found = sum(_refused_by(row, edge, code) for row in cell.rows(after))
                if found == count:
                    return found
                await asyncio.sleep(0.5)
    raise Unmet(f"The journal has {found} commands that {edge} refused as {code}; expected {count}.")


def _refused_by(row: JournalRow, edge: str, code: str) -> int:
    fields = (row.result or {}).get("fields", {})
    is_one = (row.kind, row.source, row.operation) == ("device", edge, REFUSED) and fields.get("reason") == code
    return int(fields["count"]) if is_one else 0


async def check_refused(cell: RunningCell, verdict: Verdict, before: Snapshot, row: int, codes: Iterable[str]) -> None:
    """Check response R of a verdict.

    Args:
        cell: Cell that gave the verdict.
        verdict: Verdict on the command.
        before: Snapshot before the command.
        row: Last row of the journal before the command.
        codes: Permitted reason codes.

    Raises:
        Unmet: The command was not refused like this, something changed, or the journal does not have the verdict.
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
    """Check response H: the tool is held, the latch is set, the arm stands, and it does not move until confirmed.

    Args:
        cell: Cell with the arm.
        placements: Permitted states of the placement.
        within: Time limit, s of the machine.

    Raises:
        Unmet: The response was not as required.
    """
    known = tuple(placements)
    await until(cell.client, lambda shown: shown.latched and shown.branches["placement"] in known, within)
    await stands(cell)
    if (await cell.client.state()).branches["placement"] == "held":
        await refused(cell, "placement.back_off", codes=("latched",))


async def confirmed(cell: RunningCell) -> None:
    """Check that nothing continued by itself, and that the tool can be withdrawn after the operator has confirmed.

    Raises:
        Unmet: The latch was released, or confirming or withdrawing was not accepted.
    """
    if not (await cell.client.state()).latched:
        raise Unmet("The latch was released although nobody confirmed.")
    await accept(cell.client, "robot.acknowledge")
    if (await cell.client.state()).branches["placement"] == "held":
        await accept(cell.client, "placement.back_off")


def expect(truth: bool, text: str) -> None:
    """Raise `Unmet` with a text unless a condition holds.

    Args:
        truth: Condition.
        text: Description of what is wrong if it does not hold.

    Raises:
        Unmet: The condition does not hold.
    """
    if not truth:
        raise Unmet(text)
