"""How the tour has a simulated cell report something: by a fault of its scene, or by waiting for it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from pcmrs.client import Client

STILL = [0.0, 0.0, 0.0]


@dataclass(frozen=True, slots=True)
class SceneFault:
    """What is asked of the scene.

    Attributes:
        method: Of the scene; none where nothing needs to be wrong.
        begin: Its arguments.
        mend: The arguments that undo it.
    """

    method: str
    begin: Mapping[str, Any]
    mend: Mapping[str, Any]


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
"""Events that a simulated cell can be brought to report, and by what; None where they come while all is well."""


@asynccontextmanager
async def fault(client: Client, event: str) -> AsyncIterator[None]:
    """The simulated cell has what makes it report an event, for the length of the context."""
    wrong = FAULTS[event]
    if wrong is None:
        yield
        return
    await client.request_device("scene", wrong.method, wrong.begin)
    try:
        yield
    finally:
        await client.request_device("scene", wrong.method, wrong.mend)
