"""Forces that the robot's own estimate shows to a subscriber."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from pcmrs.messages import JointState
from pcmrs.testing.errors import Unmet

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


@asynccontextmanager
async def pushes(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Magnitudes of the force on the flange that a client of the cell receives during the context, N."""
    found: list[float] = []

    def take(joints: JointState) -> None:
        if joints.flange_force is not None:
            found.append(math.hypot(*joints.flange_force))

    end = cell.client.listen("state/joints", JointState, take)
    try:
        yield found
    finally:
        await end()


def over(forces: Sequence[float], limit: float) -> dict[str, float]:
    """Details of a force over the limit, N.

    Raises:
        Unmet: There was none.
    """
    most, states = max(forces, default=0.0), sum(force > limit for force in forces)
    if not states:
        raise Unmet(f"No state of the joints shows a force over {limit:g} N: at most {most:.1f} N.")
    return {"most_newtons": most, "states over the limit": states}
