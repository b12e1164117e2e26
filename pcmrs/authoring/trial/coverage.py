"""Coverage of the answers that a workflow can give, and deviations from the expected ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from pcmrs.authoring.trial.tour import TourCommand
from pcmrs.fsm.behaviour import Joint, branch_states, line_of, operations
from pcmrs.fsm.blueprint import Blueprint

MEANINGS = {
    "pairs": "joint state and operation",
    "accepted": "of these accepted",
    "rejected": "of these rejected",
    "outcomes": "declared outcomes",
    "checks": "refusing checks",
    "steps": "failing steps",
    "doubts": "steps that leave doubt",
    "commands": "different commands",
}
"""Counters, with their meanings in words."""

KINDS = {"accepted": "accepted", "rejected": "rejected", "failed": "steps", "unknown": "doubts"}
"""Decision to its counter."""


class CoverageCount(msgspec.Struct, frozen=True):
    """A number of items out of all."""

    covered: int
    total: int


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """A command that did not end as it must.

    Attributes:
        command: ``branch.operation:ending``, with the check or step that ends it.
        before: The joint state in which it was asked.
        expected: Its expected result.
        found: Its result.
    """

    command: str
    before: str
    expected: str
    found: str

    def __str__(self) -> str:
        return f"{self.command} in {self.before}: expected {self.expected}, found {self.found}"


def coverage(
    blueprint: Blueprint, done: Iterable[TourCommand], wanted: Iterable[TourCommand]
) -> dict[str, CoverageCount]:
    """Count what has been covered, by the keys of `MEANINGS`.

    Args:
        blueprint: The workflow.
        done: Moves that have been made.
        wanted: Moves of the tour; the total also counts all that the blueprint declares.
    """
    covered, total = set(_counted(done)), set(_counted(wanted)) | set(_declared(blueprint))
    return {
        key: CoverageCount(sum(of == key for of, _ in covered & total), sum(of == key for of, _ in total))
        for key in MEANINGS
    }


def is_complete(counts: dict[str, CoverageCount]) -> bool:
    """Return true if nothing is left."""
    return all(count.covered == count.total for count in counts.values())


def deviation(blueprint: Blueprint, move: TourCommand, decision: str, after: Joint, code: str) -> Deviation | None:
    """Return how the result of a move deviates from the expected one, or None.

    Args:
        blueprint: The workflow.
        move: The move.
        decision: Decision of the verdict.
        after: Joint state after it.
        code: Code of the rejection; compared if the move has one.
    """
    as_told = decision == move.decision and after == move.after and move.code in ("", code)
    if as_told:
        return None
    expected, found = (
        f"{verdict}{f' ({why})' * bool(why)} and {line_of(branch_states(blueprint, joint))}"
        for verdict, why, joint in ((move.decision, move.code, move.after), (decision, code, after))
    )
    before = line_of(branch_states(blueprint, move.before))
    return Deviation(command=str(move), before=before, expected=expected, found=found)


def _counted(moves: Iterable[TourCommand]) -> Iterator[tuple[str, object]]:
    for move in moves:
        pair = (move.before, move.name)
        yield "pairs", pair
        yield "commands", move
        kind = KINDS[move.decision]
        if move.decision == "rejected" and move.at:
            yield "checks", (move.name, move.at)
        elif move.decision in ("accepted", "rejected"):
            yield kind, pair
        else:
            yield kind, (move.name, move.at, move.how)
        if move.decision == "accepted":
            yield "outcomes", (move.name, move.ending)


def _declared(blueprint: Blueprint) -> Iterator[tuple[str, object]]:
    """Return all that the blueprint declares; outcomes count although no joint state may ever give them."""
    for branch, operation, spec in operations(blueprint):
        if not spec.iio:
            yield from (("outcomes", (f"{branch}.{operation}", outcome)) for outcome in spec.endings)
