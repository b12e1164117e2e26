"""Asks the checks of an operation: here, or by a planner where they plan a motion."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Generic

import structlog

from pcmrs.dispatcher.attempt import Attempt
from pcmrs.dispatcher.perform import refusal
from pcmrs.dispatcher.planner import Planner
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.dispatcher.stage import Stage
from pcmrs.fsm import OperationSpec
from pcmrs.messages import Reason

log = structlog.get_logger(__name__)

MOST_PLANS = 3
"""So often a motion is planned where what it rests on changes meanwhile; then the command is rejected."""


class Checks(Generic[C, D]):
    """Asks checks, and once more what must not have changed while a planner was asked.

    Args:
        stage: What operations are performed with.
        planner: Asks checks that plan a motion; None to ask all of them here, in the loop.
        objection: Why an attempt is not allowed now, if it is not: latch, lease, failure and states.
    """

    def __init__(
        self,
        stage: Stage[C, D],
        planner: Planner[C, D] | None,
        objection: Callable[[Attempt], Reason | None],
    ) -> None:
        self._stage = stage
        self._planner = planner
        self._objection = objection
        self._registry = stage.workflow.registry

    def take_time(self, spec: OperationSpec) -> bool:
        """Whether the checks of an operation are asked by the planner, so that they have to be waited for."""
        return self._planner is not None and not self._registry.lasting.isdisjoint(spec.checks)

    def ask_at_once(self, spec: OperationSpec, run: Run[C, D]) -> Reason | None:
        """Return the first refusal of the checks, asked here; None when all agree."""
        return refusal(self._registry, spec, run)

    async def ask(self, attempt: Attempt, run_of: Callable[[], Run[C, D]]) -> tuple[Run[C, D], Reason | None]:
        """Return a run with what its checks have found, and why it is refused, if it is.

        Args:
            attempt: Whose checks.
            run_of: Makes a run of it by the present states and data.
        """
        run = run_of()
        if self._planner is None or not self.take_time(attempt.spec):
            return run, self.ask_at_once(attempt.spec, run)
        for _ in range(MOST_PLANS):
            refused = attempt.stopped or await self._plan(attempt, run)
            objection = attempt.stopped or self._objection(attempt)
            if objection is not None or self._still_true(run):
                return run, objection or refused
            run = run_of()
        text = f"What {attempt.name} rests on changed {MOST_PLANS} times while it was planned: ask again."
        return run, Reason(code="changed_while_planning", text=text, fields={"limit": MOST_PLANS})

    async def ask_again(self, spec: OperationSpec, run: Run[C, D]) -> Reason | None:
        """Asks the checks of a run that is under way by what is known now; its branches are locked."""
        if self._planner is None or not self.take_time(spec):
            return self.ask_at_once(spec, run)
        try:
            return await self._planner.check(run)
        except Exception:
            log.exception("planner_raised", command=run.command.id)
            return Reason(
                code="check_raised", text="Its checks could not be completed by the planner; the log has why."
            )

    async def _plan(self, attempt: Attempt, run: Run[C, D]) -> Reason | None:
        attempt.planning = asyncio.ensure_future(self.ask_again(attempt.spec, run))
        try:
            await asyncio.wait([attempt.planning])
            if attempt.planning.cancelled():
                text = f"The planning of {attempt.name} was cancelled."
                return attempt.stopped or Reason(code="step_cancelled", text=text)
            return attempt.planning.result()
        finally:
            attempt.planning.cancel()
            attempt.planning = None

    def _still_true(self, run: Run[C, D]) -> bool:
        procedure = self._stage.procedure
        return run.states == procedure.joint() and run.data == procedure.data
