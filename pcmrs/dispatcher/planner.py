"""Asks checks that plan motions somewhere else, so that the loop goes on meanwhile."""

from __future__ import annotations

from typing import Protocol

from pcmrs.dispatcher.run import C, D, Run
from pcmrs.messages import Reason


class Planner(Protocol[C, D]):
    """Asks the checks of operations that plan motions."""

    async def check(self, run: Run[C, D]) -> Reason | None:
        """Ask the checks of the run's operation, and leave in the run what they have found.

        Returns:
            The first refusal, or why the planner has no answer; None when all agree.
        """
