"""The way on as a message: what is next, why, and how far the procedure has come."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pcmrs.errors import RefusalError
from pcmrs.fsm import Blueprint, Guidance, Guide
from pcmrs.messages import NextStep, StageShown


def next_step(guide: Guide, states: Mapping[str, str], *, stop: int | None = None, operation: str = "") -> NextStep:
    """Return the way on from a joint state.

    Args:
        guide: Guide of the workflow.
        states: Joint state: branch to state.
        stop: Number of the Stop that is latched; None if none is.
        operation: Operation to reach, ``branch.operation``; empty for the next stage of the procedure.

    Raises:
        RefusalError: Users may not request that operation, or there is no such operation.
    """
    latched = stop is not None
    if operation:
        _check_requestable(guide.blueprint, operation)
        way = guide.to_operation(states, operation, latched=latched)
    else:
        way = guide.next_stage(states, latched=latched)
    branch, _, name = way.next.partition(".")
    spec = guide.blueprint.find(branch, name)
    return NextStep(
        next=way.next,
        why=_why(guide.blueprint, way, stop, operation),
        awaited=spec is not None and spec.event,
        path=list(way.path),
        stage="" if way.stage is None else way.stage.id,
        stages=[
            StageShown(id=stage.id, title=stage.title or stage.id, reached=reached)
            for stage, reached in guide.reached(states)
        ],
    )


def _check_requestable(blueprint: Blueprint, operation: str) -> None:
    branch, _, name = operation.partition(".")
    spec = blueprint.find(branch, name)
    if spec is None or spec.iio or spec.event:
        text = f"{operation!r} is no operation that a user may request: write branch.operation, such as "
        text += f"{next(_requestable(blueprint), 'robot.connect')}."
        raise RefusalError("unknown_operation", text, operation=operation)


def _requestable(blueprint: Blueprint) -> Iterator[str]:
    for branch, declared in blueprint.branches.items():
        yield from (f"{branch}.{name}" for name, spec in declared.operations.items() if not (spec.iio or spec.event))


def _why(blueprint: Blueprint, way: Guidance, stop: int | None, operation: str) -> str:
    if stop is not None and way.path and way.path[-1] in blueprint.unlatching and way.stage is None:
        return f"Stop {stop} is latched: {_then(way)} releases it."
    if operation:
        if not way.path:
            return f"From here, nothing that users may request leads to {operation}."
        return f"{operation} is allowed now." if way.path == (operation,) else f"It leads to {operation}: {_then(way)}."
    if way.stage is None:
        return "All stages are reached."
    title = way.stage.title or way.stage.id
    if not way.path:
        return f"The next stage is “{title}”. From here, nothing that users may request leads to it."
    return f"The next stage is “{title}”: {_then(way)}."


def _then(way: Guidance) -> str:
    return ", then ".join(way.path)
