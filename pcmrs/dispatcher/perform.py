"""Performs one operation: its checks, then its steps under a deadline, and how that ended."""

from __future__ import annotations

import asyncio
import inspect
from dataclasses import dataclass
from typing import Literal

import structlog

from pcmrs.dispatcher.registry import Registry
from pcmrs.dispatcher.run import C, D, Run
from pcmrs.errors import DeviceError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.fsm import START_OUTCOME, Change, Closure, OperationSpec
from pcmrs.messages import Decision, Reason

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class Ending:
    """How the steps ended: ``done`` with an outcome, ``failed`` or ``unknown`` with a reason."""

    kind: Literal["done", "failed", "unknown"]
    outcome: str = START_OUTCOME
    reason: Reason | None = None


def refusal(registry: Registry[C, D], spec: OperationSpec, run: Run[C, D]) -> Reason | None:
    """Runs the operation's checks; returns the first refusal, or None when all agree."""
    for name in spec.checks:
        try:
            registry.checks[name](run)
        except PcmrsError as error:
            return reason_of(error, check=name)
        except Exception:
            log.exception("check_raised", check=name, command=run.command.id)
            return Reason(code="check_raised", text=f"Check {name} could not be completed.", fields={"check": name})
    return None


async def take_steps(registry: Registry[C, D], spec: OperationSpec, run: Run[C, D]) -> Ending:
    """Takes the operation's steps in order and in time; cancellation passes through to the caller."""
    step = ""
    try:
        async with run.clock.timeout(spec.timeout_s):
            for step in spec.steps:
                taken = registry.steps[step](run)
                if inspect.isawaitable(taken):
                    await taken
                _heed_cancellation()
    except TimeoutError:
        text = f"Step {step} did not end within {spec.timeout_s} s."
        fields = {"step": step, "timeout": spec.timeout_s}
        return Ending("failed", reason=Reason(code="deadline_passed", text=text, fields=fields))
    except Exception as error:
        return _ending_by(error, step, run)
    return Ending("done", outcome=run.outcome or START_OUTCOME)


def take_steps_at_once(registry: Registry[C, D], spec: OperationSpec, run: Run[C, D]) -> Ending:
    """Takes the steps of an operation that touches nothing outside: there is nothing to wait for."""
    step = ""
    try:
        for step in spec.steps:
            registry.steps[step](run)
    except Exception as error:
        return _ending_by(error, step, run)
    return Ending("done", outcome=run.outcome or START_OUTCOME)


def _ending_by(error: Exception, step: str, run: Run[C, D]) -> Ending:
    if isinstance(error, UnknownOutcomeError):
        return Ending("unknown", reason=reason_of(error, step=step))
    if isinstance(error, PcmrsError):
        return Ending("failed", reason=reason_of(error, step=step))
    log.error("step_raised", step=step, command=run.command.id, exc_info=error)
    text = f"Step {step} raised an error; the log has it."
    return Ending("failed", reason=Reason(code="step_raised", text=text, fields={"step": step}))


def _heed_cancellation() -> None:
    """Ends the steps although the one before has swallowed the cancellation of Stop or the deadline."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def consequence(closure: Closure, ending: Ending, name: str) -> tuple[Decision, Change | None, Reason | None]:
    """The decision, the change to commit and the reason that an ending leads to."""
    if ending.kind == "unknown":
        return "unknown", closure.unknown, ending.reason
    if ending.kind == "failed":
        return "failed", closure.failure, ending.reason
    if ending.outcome not in closure.outcomes:
        text = f"{name} ended as {ending.outcome!r}; only {list(closure.outcomes)} can be taken now."
        return "failed", closure.failure, Reason(code="undeclared_outcome", text=text)
    return "accepted", closure.outcomes[ending.outcome], None


def reason_of(error: PcmrsError, **where: str) -> Reason:
    """The reason that a verdict gives for an error."""
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    if isinstance(error, DeviceError) and "code" in error.fields:
        code = str(error.fields["code"])
    return Reason(code=code, text=error.text, fields={**error.fields, **where})
