"""Actions of a campaign in addition to `pcmrs.testing.driving`: the tool follows, the scene has a fault."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Any

from pcmrs.client import Client
from pcmrs.errors import PcmrsError
from pcmrs.testing.driving import SEEN, accept, state, to_placed, until
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import is_sham

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


FOLLOWED = 1.5
"""Time for which the tool follows before a fault is injected, s of the machine."""

TOO_BUSY = "The tool does not follow without the fault either. This machine is too busy for a cell in real time."


async def to_following(client: Client) -> None:
    """Bring the tool to the head and have it follow until it counts as aligned.

    Raises:
        NotRun: The tool does not follow before any fault was injected: the machine is too busy for a cell in real time.
    """
    await to_placed(client)
    await asyncio.sleep(SEEN)
    await accept(client, "placement.follow")
    try:
        await until(client, lambda snapshot: snapshot.branches["alignment"] == "1")
        await asyncio.sleep(FOLLOWED)
    except Unmet as error:
        raise NotRun(f"{TOO_BUSY} {error.text}") from None
    if await state(client, "placement") != "following":
        raise NotRun(f"{TOO_BUSY} It was held within {FOLLOWED:g} s.")


@asynccontextmanager
async def injected(
    cell: RunningCell, fault: str, begin: dict[str, Any] | None = None, end: dict[str, Any] | None = None
) -> AsyncIterator[None]:
    """Inject a fault into the simulated scene for the length of the context.

    Args:
        cell: Cell with the scene.
        fault: Name of the fault, from `pcmrs-sim faults`.
        begin: Arguments that inject it; ``on`` is added if `end` is not given.
        end: Arguments that end it; empty if it ends by itself; by default those of `begin`, with ``on`` false.
    """
    began = dict(begin or {}) if end is not None else {**(begin or {}), "on": True}
    ended = end if end is not None else {**began, "on": False}
    if is_sham():
        yield
        return
    await cell.scene.inject(fault, began)
    try:
        yield
    except BaseException:
        with suppress(PcmrsError):  # the first error says more than a second one here
            await _end(cell, fault, ended)
        raise
    await _end(cell, fault, ended)


async def _end(cell: RunningCell, fault: str, arguments: dict[str, Any]) -> None:
    if arguments:
        await cell.scene.inject(fault, arguments)
