"""Faults by which the tour makes a simulated cell report an event."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from pcmrs.client import Client

STILL = [0.0, 0.0, 0.0]


@dataclass(frozen=True, slots=True)
class SceneFault:
    """Request to the simulated scene.

    Attributes:
        method: Method of the scene.
        begin: Arguments that inject the fault.
        end: Arguments that end the fault.
    """

    method: str
    begin: Mapping[str, Any]
    end: Mapping[str, Any]


FAULTS: dict[str, SceneFault | None] = {
    "link_lost": SceneFault("cut_robot", {"cut": True}, {"cut": False}),
    "outside": SceneFault("occlude", {"body": "coil", "hidden": True}, {"body": "coil", "hidden": False}),
    "reference_moved": SceneFault(
        "bump_reference",
        {"offset_in_body_ref": [0.01, 0.0, 0.0], "rotvec": STILL},
        {"offset_in_body_ref": [-0.01, 0.0, 0.0], "rotvec": STILL},
    ),
    "within": None,
}
"""Faults by the event that a simulated cell reports because of them; None if the event comes without a fault."""


@asynccontextmanager
async def fault(client: Client, event: str) -> AsyncIterator[None]:
    """Make the simulated cell report an event, by a fault for the length of the context.

    Args:
        client: Client of the cell.
        event: Key of `FAULTS`.
    """
    wrong = FAULTS[event]
    if wrong is None:
        yield
        return
    await client.request_device("scene", wrong.method, wrong.begin)
    try:
        yield
    finally:
        await client.request_device("scene", wrong.method, wrong.end)
