"""From pending to completed command: checks, intent, steps, and the change of states that follows from them."""

from __future__ import annotations

import asyncio
from typing import Generic

from pcmrs.dispatcher._activities import Activities
from pcmrs.dispatcher.command_checks import check_in_time
from pcmrs.dispatcher.decisions import Decisions
from pcmrs.dispatcher.events import CompletedCommand, Recorder
from pcmrs.dispatcher.execution import (
    Checks,
    ExecutionContext,
    StepResult,
    consequence,
    performing,
    reason_of,
    take_steps,
    take_steps_at_once,
)
from pcmrs.dispatcher.locks import Locks, PendingCommand
from pcmrs.dispatcher.workflow import C, D, Run
from pcmrs.errors import PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.failpoints import failpoint
from pcmrs.fsm import Denial, OperationSpec
from pcmrs.messages import DryRunResult, Reason, TouchPrompt


class Performer(Generic[C, D]):
    """Perform commands that have their locks.

    Args:
        context: Shared parts of the dispatcher.
        decisions: Concludes completed commands.
        recorder: The journal, for intents.
        activities: Activities that give way to a motion.
        checks: Checks of operations.
    """

    def __init__(
        self,
        context: ExecutionContext[C, D],
        decisions: Decisions[C, D],
        recorder: Recorder,
        activities: Activities[C, D],
        checks: Checks[C, D],
    ) -> None:
        self._context = context
        self._locks = context.locks
        self._decisions = decisions
        self._recorder = recorder
        self._activities = activities
        self._checks = checks
        self._registry = context.workflow.registry

    def start(self, pending: PendingCommand) -> None:
        """Perform an operation: at once, or as its own task if it has side effects or is planned."""
        self._locks.running.append(pending)
        pending.end_wait()
        if pending.side_effecting or self._checks.take_time(pending.spec):
            pending.task = self._context.tasks.spawn(self._perform(pending))
        else:
            self._perform_at_once(pending)

    async def dry_run(self, pending: PendingCommand) -> DryRunResult:
        """Ask the checks of an operation only: they are pure, and what they have prepared is dropped."""
        run, refused = await self._checks.ask(pending, lambda: self._run_of(pending))
        return DryRunResult(reason=refused, undecided=run.undecided, result=run.result)

    def has_side_effects(self, spec: OperationSpec) -> bool:
        """Return whether the steps of an operation act on the world."""
        releases = spec.unlatches and self._context.release is not None
        return releases or not self._registry.side_effecting.isdisjoint(spec.steps)

    def _perform_at_once(self, pending: PendingCommand) -> None:
        """Perform an operation without side effects, from its checks to its completion."""
        pending.started = pending.ending = True
        token = performing.set(id(self._context.procedure))
        run = self._run_of(pending)
        try:
            refused = self._late(pending) or self._checks.ask_at_once(pending.spec, run)
            ending = None if refused else take_steps_at_once(self._registry, pending.spec, run)
            self._conclude(pending, run, refused, ending)
        except Exception as error:
            self._fail_with(pending, error)
        finally:
            performing.reset(token)

    async def _perform(self, pending: PendingCommand) -> None:
        """Perform an operation that has side effects or is planned, as its own task."""
        performing.set(id(self._context.procedure))
        run = self._run_of(pending)
        try:
            refused = self._late(pending)
            if refused is None:
                run, refused = await self._checks.ask(pending, lambda: self._run_of(pending))
            ending = None if refused else await self._steps(pending, run)
            pending.end_steps()
            await self._wait_for_conflicts(pending)
            self._conclude(pending, run, refused, ending)
        except Exception as error:
            pending.end_steps()
            self._fail_with(pending, error)

    def _fail_with(self, pending: PendingCommand, error: Exception) -> None:
        """Handle an error of the program itself: the command keeps no locks, and nobody waits for it."""
        self._decisions.fail_with(CompletedCommand(pending.command, pending.verdict, "unknown", pending=pending), error)

    def _late(self, pending: PendingCommand) -> Reason | None:
        """Why it is too late for the checks of a command that moves or acts: its sender may not expect it any more."""
        if pending.acts:
            try:
                check_in_time(pending.name, asyncio.get_running_loop().time() - pending.arrived)
            except RefusalError as error:
                return reason_of(error)
        return None

    async def _wait_for_conflicts(self, pending: PendingCommand) -> None:
        """Wait for operations on branches that this one would move now, and would not have when it started.

        A retreat does not keep others from changing the plan of its standoff: only here can the two meet.
        """
        pending.committing = True
        while conflicts := self._conflicts(pending):
            await asyncio.wait([other.verdict for other in conflicts])

    def _conflicts(self, pending: PendingCommand) -> list[PendingCommand]:
        closure = self._context.procedure.ask(pending.command.branch, pending.command.operation)
        if isinstance(closure, Denial):
            return []
        beyond = Locks(closure.writes - pending.locks.writes, frozenset())
        others = (other for other in self._locks.running if not other.committing)
        return [other for other in others if beyond.conflicts(other.locks)]

    async def _steps(self, pending: PendingCommand, run: Run[C, D]) -> StepResult:
        """Take the steps, those with side effects after the intent is durable; hold the robot if a motion fails."""
        pending.started = True
        if not pending.side_effecting:
            pending.end_steps()
            return take_steps_at_once(self._registry, pending.spec, run)
        try:
            self._context.coordinator.publish_snapshot()
            failpoint("dispatcher.before_intent")
            await asyncio.shield(self._recorder.intent(pending.command, run.states))
            failpoint("dispatcher.after_intent")
            ending = StepResult("failed", reason=pending.stopped)
            if pending.stopped is None:
                failpoint("dispatcher.before_steps")
                ending = (
                    await self._take_over(pending)
                    or await self._release(pending, run)
                    or await take_steps(self._registry, pending.spec, run)
                )
                failpoint("dispatcher.after_steps")
        except asyncio.CancelledError:
            cancelled = Reason(code="step_cancelled", text=f"A task that {pending.name} waited for was cancelled.")
            ending = StepResult("failed", reason=pending.stopped or cancelled)
        pending.end_steps()
        if pending.moves and ending.kind != "done" and not await self._context.hold.end_motion():
            return StepResult("unknown", reason=ending.reason)
        return ending

    async def _take_over(self, pending: PendingCommand) -> StepResult | None:
        """Let activities give way to a motion; return the result of the motion if they do not."""
        if not pending.moves:
            return None
        try:
            async with self._context.clock.timeout(pending.spec.timeout_s):
                await self._activities.yield_to_motion()
        except TimeoutError:
            text = f"An activity that moves the robot has not given way within {pending.spec.timeout_s} s."
            fields = {"timeout": pending.spec.timeout_s}
            return StepResult("failed", reason=Reason(code="deadline_passed", text=text, fields=fields))
        return None

    async def _release(self, pending: PendingCommand, run: Run[C, D]) -> StepResult | None:
        """Release the devices that Stop has latched; return the result if the robot does not confirm it."""
        if not pending.spec.unlatches or self._context.release is None:
            return None
        try:
            latched = await self._context.release(self._context.procedure.latched)
        except PcmrsError as error:
            reason = reason_of(error, step="release")
            return StepResult("unknown" if isinstance(error, UnknownOutcomeError) else "failed", reason=reason)
        if latched:
            run.result["still_latched"] = list(latched)
        return None

    def _run_of(self, pending: PendingCommand) -> Run[C, D]:
        def show(fraction: float) -> None:
            pending.progress = fraction
            self._context.coordinator.publish_snapshot()

        def show_prompt(prompt: TouchPrompt | None) -> None:
            pending.prompt = prompt
            self._context.coordinator.publish_snapshot()

        context = self._context
        states, data = context.procedure.joint(), context.procedure.data
        pending.since = context.procedure.sequence
        motion, latched = pending.spec.motion, context.procedure.latched
        run = Run(
            pending.command,
            pending.payload,
            states,
            context.cell,
            context.clock,
            data,
            show,
            motion=motion,
            latched=latched,
            _show_prompt=show_prompt,
        )
        run.use_planner(
            lambda: self._checks.ask_again(pending.spec, run),
            lambda check, within: self._checks.ask_in_step(pending, run, check, within),
        )
        return run

    def _conclude(
        self, pending: PendingCommand, run: Run[C, D], refused: Reason | None, ending: StepResult | None
    ) -> None:
        """Conclude a command from its refusal, or from the result of its steps."""
        command, verdict = pending.command, pending.verdict
        if ending is None:
            self._decisions.conclude(CompletedCommand(command, verdict, "rejected", refused, pending))
            return
        at_once = not pending.side_effecting
        closure = self._context.procedure.ask(command.branch, command.operation)
        if isinstance(closure, Denial):
            raise PcmrsError(f"{closure.text} It was allowed when {pending.name} began.")
        decision, change, reason = consequence(closure, self._still_so(pending, ending), pending.name)
        self._decisions.conclude(CompletedCommand(command, verdict, decision, reason, pending, run, change, at_once))

    def _still_so(self, pending: PendingCommand, ending: StepResult) -> StepResult:
        """Return the result of the steps, or a failure if a branch has changed that the result requires.

        A retreat keeps nobody from changing those: a standoff counts only for the plan that it was found by.
        """
        outcome = pending.spec.endings.get(ending.outcome)
        if ending.kind != "done" or outcome is None:
            return ending
        changed = self._context.procedure.changed_since(outcome.requires, pending.since)
        if not changed:
            return ending
        text = f"{pending.name} ended as {ending.outcome!r}, but {' and '.join(changed)} has changed meanwhile."
        return StepResult("failed", reason=Reason(code="outcome_outdated", text=text, fields={"branches": changed}))
