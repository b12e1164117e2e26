"""From attempt to conclusion: checks, intent, steps, and what the ending means for the states."""

from __future__ import annotations

import asyncio
from typing import Generic

from pcmrs.dispatcher.activities import Activities
from pcmrs.dispatcher.admission import check_in_time
from pcmrs.dispatcher.decisions import Conclusion, Decisions
from pcmrs.dispatcher.execution import (
    Checks,
    Ending,
    Stage,
    consequence,
    performing,
    reason_of,
    take_steps,
    take_steps_at_once,
)
from pcmrs.dispatcher.locks import Attempt, Lanes, Locks
from pcmrs.dispatcher.recorder import Recorder
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.errors import PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.failpoints import failpoint
from pcmrs.fsm import Denial, OperationSpec
from pcmrs.messages import Prospect, Reason


class Performer(Generic[C, D]):
    """Performs attempts that have their locks.

    Args:
        stage: What they are performed with.
        lanes: Where others run and wait.
        decisions: Where they are concluded.
        recorder: Where intents are journalled.
        activities: What gives way to a motion.
        checks: Ask whether an operation may begin.
    """

    def __init__(
        self,
        stage: Stage[C, D],
        lanes: Lanes,
        decisions: Decisions[C, D],
        recorder: Recorder,
        activities: Activities[C, D],
        checks: Checks[C, D],
    ) -> None:
        self._stage = stage
        self._lanes = lanes
        self._decisions = decisions
        self._recorder = recorder
        self._activities = activities
        self._checks = checks
        self._registry = stage.workflow.registry

    def start(self, attempt: Attempt) -> None:
        """Performs an operation: at once, or as a task of its own where it touches the world or is planned."""
        self._lanes.running.append(attempt)
        attempt.end_wait()
        if attempt.worldly or self._checks.take_time(attempt.spec):
            attempt.task = self._stage.tasks.spawn(self._perform(attempt))
        else:
            self._perform_at_once(attempt)

    async def prospect(self, attempt: Attempt) -> Prospect:
        """Asks an operation's checks, and nothing more: they are pure, and what they have prepared is thrown away."""
        run, refused = await self._checks.ask(attempt, lambda: self._run_of(attempt))
        return Prospect(reason=refused, undecided=run.undecided, result=run.result)

    def touches_world(self, spec: OperationSpec) -> bool:
        """Whether an operation takes steps in the world."""
        releases = spec.unlatches and self._stage.release is not None
        return releases or not self._registry.worldly.isdisjoint(spec.steps)

    def _perform_at_once(self, attempt: Attempt) -> None:
        """Performs an operation that touches nothing outside, from its checks to its conclusion."""
        attempt.begun = attempt.ending = True
        token = performing.set(id(self._stage.procedure))
        run = self._run_of(attempt)
        try:
            refused = self._late(attempt) or self._checks.ask_at_once(attempt.spec, run)
            ending = None if refused else take_steps_at_once(self._registry, attempt.spec, run)
            self._conclude(attempt, run, refused, ending)
        except Exception as error:
            self._break_off(attempt, error)
        finally:
            performing.reset(token)

    async def _perform(self, attempt: Attempt) -> None:
        """Performs an operation that touches the world or is planned, as a task of its own."""
        performing.set(id(self._stage.procedure))
        run = self._run_of(attempt)
        try:
            refused = self._late(attempt)
            if refused is None:
                run, refused = await self._checks.ask(attempt, lambda: self._run_of(attempt))
            ending = None if refused else await self._steps(attempt, run)
            attempt.end_steps()
            await self._let_others_end(attempt)
            self._conclude(attempt, run, refused, ending)
        except Exception as error:
            attempt.end_steps()
            self._break_off(attempt, error)

    def _break_off(self, attempt: Attempt, error: Exception) -> None:
        """An error of the program itself, at whatever point: the attempt keeps no locks, and nobody waits for it."""
        self._decisions.break_off(Conclusion(attempt.command, attempt.verdict, "unknown", attempt=attempt), error)

    def _late(self, attempt: Attempt) -> Reason | None:
        """Why the checks of what moves or acts do not begin: whoever asked may not expect it any more."""
        if attempt.acts:
            try:
                check_in_time(attempt.name, asyncio.get_running_loop().time() - attempt.arrived)
            except RefusalError as error:
                return reason_of(error)
        return None

    async def _let_others_end(self, attempt: Attempt) -> None:
        """Waits while other operations run on branches that this one would move now, and did not when it began.

        A retreat does not keep others from changing what its standoff rests on: only here can the two meet.
        """
        attempt.committing = True
        while in_the_way := self._in_the_way(attempt):
            await asyncio.wait([other.verdict for other in in_the_way])

    def _in_the_way(self, attempt: Attempt) -> list[Attempt]:
        closure = self._stage.procedure.ask(attempt.command.branch, attempt.command.operation)
        if isinstance(closure, Denial):
            return []
        beyond = Locks(closure.writes - attempt.locks.writes, frozenset())
        others = (other for other in self._lanes.running if not other.committing)
        return [other for other in others if beyond.conflicts(other.locks)]

    async def _steps(self, attempt: Attempt, run: Run[C, D]) -> Ending:
        """Takes the steps, those in the world after the intent is durable; holds what has failed to move."""
        attempt.begun = True
        if not attempt.worldly:
            attempt.end_steps()
            return take_steps_at_once(self._registry, attempt.spec, run)
        try:
            self._stage.show()
            failpoint("dispatcher.before_intent")
            await asyncio.shield(self._recorder.intent(attempt.command, run.states))
            failpoint("dispatcher.after_intent")
            ending = Ending("failed", reason=attempt.stopped)
            if attempt.stopped is None:
                failpoint("dispatcher.before_steps")
                ending = (
                    await self._take_over(attempt)
                    or await self._release(attempt, run)
                    or await take_steps(self._registry, attempt.spec, run)
                )
                failpoint("dispatcher.after_steps")
        except asyncio.CancelledError:
            cancelled = Reason(code="step_cancelled", text=f"What {attempt.name} waited for was cancelled.")
            ending = Ending("failed", reason=attempt.stopped or cancelled)
        attempt.end_steps()
        if attempt.moves and ending.kind != "done" and not await self._stage.hold.end_motion():
            return Ending("unknown", reason=ending.reason)
        return ending

    async def _take_over(self, attempt: Attempt) -> Ending | None:
        """Lets activities give way to a motion; how it has ended already where they do not."""
        if not attempt.moves:
            return None
        try:
            async with self._stage.clock.timeout(attempt.spec.timeout_s):
                await self._activities.give_way()
        except TimeoutError:
            text = f"An activity that moves the robot has not given way within {attempt.spec.timeout_s} s."
            fields = {"timeout": attempt.spec.timeout_s}
            return Ending("failed", reason=Reason(code="deadline_passed", text=text, fields=fields))
        return None

    async def _release(self, attempt: Attempt, run: Run[C, D]) -> Ending | None:
        """Releases the devices that Stop has latched; how it has ended already where the robot does not confirm it."""
        if not attempt.spec.unlatches or self._stage.release is None:
            return None
        try:
            latched = await self._stage.release(self._stage.procedure.latched)
        except PcmrsError as error:
            reason = reason_of(error, step="release")
            return Ending("unknown" if isinstance(error, UnknownOutcomeError) else "failed", reason=reason)
        if latched:
            run.result["still_latched"] = list(latched)
        return None

    def _run_of(self, attempt: Attempt) -> Run[C, D]:
        def show(fraction: float) -> None:
            attempt.progress = fraction
            self._stage.show()

        stage = self._stage
        states, data = stage.procedure.joint(), stage.procedure.data
        attempt.since = stage.procedure.sequence
        motion, latched = attempt.spec.motion, stage.procedure.latched
        run = Run(
            attempt.command,
            attempt.payload,
            states,
            stage.cell,
            stage.clock,
            data,
            show,
            motion=motion,
            latched=latched,
        )
        run.use_planner(lambda: self._checks.ask_again(attempt.spec, run))
        return run

    def _conclude(self, attempt: Attempt, run: Run[C, D], refused: Reason | None, ending: Ending | None) -> None:
        """Works out what the refusal or the ending means for the states."""
        command, verdict = attempt.command, attempt.verdict
        if ending is None:
            self._decisions.conclude(Conclusion(command, verdict, "rejected", refused, attempt))
            return
        at_once = not attempt.worldly
        closure = self._stage.procedure.ask(command.branch, command.operation)
        if isinstance(closure, Denial):
            raise PcmrsError(f"{closure.text} It was allowed when {attempt.name} began.")
        decision, change, reason = consequence(closure, self._still_so(attempt, ending), attempt.name)
        self._decisions.conclude(Conclusion(command, verdict, decision, reason, attempt, run, change, at_once))

    def _still_so(self, attempt: Attempt, ending: Ending) -> Ending:
        """How the steps ended, if the branches that this rests on are as the steps have seen them.

        A retreat keeps nobody from changing those: a standoff counts for no other plan than the one it was found by.
        """
        outcome = attempt.spec.endings.get(ending.outcome)
        if ending.kind != "done" or outcome is None:
            return ending
        changed = self._stage.procedure.changed_since(outcome.requires, attempt.since)
        if not changed:
            return ending
        text = f"{attempt.name} ended as {ending.outcome!r}, but {' and '.join(changed)} has changed meanwhile."
        return Ending("failed", reason=Reason(code="outcome_outdated", text=text, fields={"branches": changed}))
