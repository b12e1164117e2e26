"""The engine on a test tour, each answer compared with what must come of it."""

from __future__ import annotations

from collections.abc import Iterator

from pcmrs.authoring.trial.coverage import Deviation, deviation
from pcmrs.authoring.trial.tour import Move, Tour
from pcmrs.fsm.behaviour import joint_of
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Denial
from pcmrs.fsm.engine import Engine


def tour_engine(blueprint: Blueprint, tour: Tour) -> Iterator[tuple[Move, Deviation | None]]:
    """Take the engine through a tour: what it leaves to its callers, checks and who may ask, it does not see.

    Yields:
        Every command and what was not as it must be; a stretch that has left the tour is not gone on with.
    """
    for stretch in tour.stretches:
        engine = Engine(blueprint)
        for move in stretch:
            decision, code = (move.decision, move.code) if _of_callers(move) else _performed(engine, move)
            after = joint_of(blueprint, engine.joint())
            yield move, deviation(blueprint, move, decision, after, code)
            if after != move.after:
                break


def _performed(engine: Engine, move: Move) -> tuple[str, str]:
    """Decision and code of the engine; what it allows although it must not is not performed."""
    said = engine.ask(move.branch, move.operation)
    if isinstance(said, Denial):
        return "rejected", said.code
    if move.decision == "rejected":
        return "accepted", ""
    if move.decision == "accepted" and move.ending not in said.outcomes:
        return f"no outcome {move.ending}", ""
    engine.perform(move.branch, move.operation, move.ending)
    return move.decision, ""


def _of_callers(move: Move) -> bool:
    return bool(move.ending == "rejected" and move.at) or move.code in ("internal_operation", "event_operation")
