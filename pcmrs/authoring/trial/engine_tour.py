"""A test tour of the engine, each answer compared with the expected one."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.authoring.trial.coverage import Deviation, deviation
from pcmrs.authoring.trial.tour import Tour, TourCommand
from pcmrs.fsm.behaviour import joint_of
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.engine import Engine


def tour_engine(blueprint: Blueprint, tour: Tour) -> Iterator[tuple[TourCommand, Deviation | None]]:
    """Take the engine through a tour. It does not see the checks and roles that its callers are responsible for.

    Args:
        blueprint: The workflow.
        tour: Its tour.

    Yields:
        Every command and its deviation. A stretch ends as soon as it has left the tour.
    """
    for stretch in tour.stretches:
        engine = Engine(blueprint)
        for move in stretch:
            decision, code = (move.decision, move.code) if _of_callers(move) else _performed(engine, move)
            after = joint_of(blueprint, engine.joint())
            yield move, deviation(blueprint, move, decision, after, code)
            if after != move.after:
                break


def _performed(engine: Engine, move: TourCommand) -> tuple[str, str]:
    """Return the decision and code of the engine. A command that it wrongly allows is not performed."""
    answer = engine.ask(move.branch, move.operation)
    if isinstance(answer, Denial):
        return "rejected", answer.code
    if move.decision == "rejected":
        return "accepted", ""
    if move.decision == "accepted" and move.ending not in answer.outcomes:
        return f"no outcome {move.ending}", ""
    engine.perform(move.branch, move.operation, move.ending)
    return move.decision, ""


def _of_callers(move: TourCommand) -> bool:
    return bool(move.ending == "rejected" and move.at) or move.code in ("internal_operation", "event_operation")
