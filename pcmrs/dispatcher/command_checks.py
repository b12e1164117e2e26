"""Checks of a command that need no state: operation, role, age and arguments."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from pcmrs.clock import Clock
from pcmrs.dispatcher.workflow import Workflow
from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint, OperationSpec
from pcmrs.fsm.finding import hint
from pcmrs.messages import Command

EVENT_SOURCES = ("device:", "detector:", "timer:", "operation:", "activity:")

CHECKS_BEGIN_WITHIN = 0.1
"""Limit from the arrival of a command that moves or acts on the patient to its checks, s of the event loop's clock."""
CLOCK_TOLERANCE = 5.0
"""Limit by which a sender's wall clock may be ahead of ours, s."""


def find_operation(workflow: Workflow[Any, Any], command: Command) -> OperationSpec:
    """Return the operation that a command names.

    Args:
        workflow: The procedure.
        command: The command.

    Raises:
        RefusalError: There is no such branch or operation, or users may not request it.
    """
    branch = workflow.blueprint.branches.get(command.branch)
    if branch is None:
        known = list(workflow.blueprint.branches)
        text = f"There is no branch {command.branch!r}; {hint(command.branch, known)}"
        raise RefusalError("unknown_branch", text, branch=command.branch, known=known)
    spec = branch.operations.get(command.operation)
    if spec is None:
        known = [name for name, each in branch.operations.items() if not each.iio and not each.event]
        text = f"{command.branch} has no operation {command.operation!r}; {hint(command.operation, known)}"
        raise RefusalError("unknown_operation", text, operation=command.operation, known=known)
    if spec.iio:
        text = f"{command.branch}.{command.operation} is called by a child branch only, never from outside."
        raise RefusalError("internal_operation", text, operation=command.operation)
    if spec.event and not command.source.startswith(EVENT_SOURCES):
        text = f"{command.branch}.{command.operation} is called by a device, detector or timer only."
        raise RefusalError("event_operation", text, operation=command.operation, source=command.source)
    return spec


def is_event(blueprint: Blueprint, command: Command) -> bool:
    """Return whether the daemon itself calls an event operation, which reports what has happened already.

    Args:
        blueprint: The workflow.
        command: The command.
    """
    spec = blueprint.find(command.branch, command.operation)
    return spec is not None and spec.event and command.source.startswith(EVENT_SOURCES)


def check_role(command: Command, spec: OperationSpec) -> None:
    """Refuse an operation that the role does not allow, whatever an edge or a router has let through.

    Args:
        command: The command, with its role.
        spec: The operation.

    Raises:
        RefusalError: ``role_not_allowed``.
    """
    if command.source.startswith(EVENT_SOURCES):
        return
    allowed = spec.allowed_roles
    if command.role not in allowed:
        text = f"A {command.role} may not ask for {command.branch}.{command.operation}: {' or '.join(allowed)} may."
        raise RefusalError("role_not_allowed", text, user=command.user, role=command.role, allowed=allowed)


def read_payload(workflow: Workflow[Any, Any], command: Command, spec: OperationSpec) -> msgspec.Struct:
    """Return the arguments as the operation's payload type, without the Stop that an acknowledgement names.

    Args:
        workflow: The procedure, with its payload types.
        command: The command.
        spec: Its operation.

    Raises:
        RefusalError: They do not fit the type, or a number is not finite.
    """
    kind = workflow.registry.payloads[spec.payload]
    what = f"{command.branch}.{command.operation}"
    arguments = dict(command.arguments)
    try:
        if spec.unlatches:
            msgspec.convert(arguments.pop("stop", None), int | None)
        payload: msgspec.Struct = msgspec.convert(arguments, kind)
    except msgspec.ValidationError as error:
        text = "; ".join(_wrong_names(kind, arguments)) or f"{error}."
        raise RefusalError("bad_arguments", f"{what}: {text}", arguments=list(command.arguments)) from error
    if (found := _not_finite(command.arguments)) is not None:
        path, value = found
        text = f"{what}: {path} is {value}; every number must be finite."
        raise RefusalError("bad_arguments", text, argument=path, value=str(value))
    return payload


def _wrong_names(kind: type[msgspec.Struct], arguments: Mapping[str, Any]) -> Iterator[str]:
    """Yield all arguments that are missing and all that are unknown, so that one refusal names them together."""
    fields = msgspec.structs.fields(kind)
    known = [field.encode_name for field in fields]
    missing = [field.encode_name for field in fields if field.required and field.encode_name not in arguments]
    if missing:
        yield f"missing arguments: {', '.join(missing)}"
    for name in arguments:
        if name not in known:
            yield f"unknown argument {name!r}, " + (hint(name, known) if known else "there are none")


def check_fresh(clock: Clock, command: Command) -> None:
    """Refuse a command that arrives later than its sender wanted, or whose age is unknown.

    Args:
        clock: The cell's clock.
        command: The command.

    Raises:
        RefusalError: ``expired``: the command is older than its `ttl`, or was sent in the future. ``bad_arguments``:
            its `ttl` is no limit.
    """
    sent, ttl = command.sent, command.ttl
    if ttl is not None and (sent is None or not 0.0 <= ttl < math.inf):
        text = f"A ttl of {ttl} s with sent at {sent} sets no limit: give both, ttl finite and not negative."
        raise RefusalError("bad_arguments", text, ttl=str(ttl), sent=str(sent))
    if sent is None:
        return
    age = clock.wall() - sent
    if age < -CLOCK_TOLERANCE:
        text = f"The command was sent {-age:.3f} s in the future, more than {CLOCK_TOLERANCE:g} s: set its clock."
        raise RefusalError("expired", text, age=age, limit=CLOCK_TOLERANCE)
    if ttl is not None and age > ttl:
        text = f"The command is {age:.3f} s old; its sender set a limit of {ttl:.3f} s. Send it again."
        raise RefusalError("expired", text, age=age, limit=ttl)


def check_in_time(name: str, age: float) -> None:
    """Refuse a command that moves or acts if its checks are late: its sender may not expect it any more.

    Args:
        name: Branch and operation.
        age: Time since its arrival, s.

    Raises:
        RefusalError: ``expired``.
    """
    if age > CHECKS_BEGIN_WITHIN:
        text = (
            f"{name} was to begin {age:.3f} s after it had arrived, and may not later than {CHECKS_BEGIN_WITHIN:g} s: "
            "the daemon was held up. Look, then ask again."
        )
        raise RefusalError("expired", text, age=age, limit=CHECKS_BEGIN_WITHIN)


def _not_finite(arguments: Mapping[str, Any]) -> tuple[str, float] | None:
    """Return the path and value of a number that is not finite; None if all are."""
    parts: list[tuple[str, Any]] = list(arguments.items())
    for path, value in parts:  # which grows by what each part holds: every command passes here, so nothing is called
        if isinstance(value, float):
            if not math.isfinite(value):
                return path, value
        elif isinstance(value, dict):
            parts += [(f"{path}.{key}", item) for key, item in value.items()]
        elif isinstance(value, list | tuple):
            parts += [(f"{path}.{index}", item) for index, item in enumerate(value)]
    return None
