"""How much of what a workflow can answer has been seen, and what was answered otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import msgspec

from pcmrs.authoring.trial.tour import Move
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
"""What is counted, in words."""

KINDS = {"accepted": "accepted", "rejected": "rejected", "failed": "steps", "unknown": "doubts"}
"""What a decision counts for."""


class Count(msgspec.Struct, frozen=True):
    """How many of how many."""

    covered: int
    total: int


class Deviation(msgspec.Struct, frozen=True, kw_only=True):
    """A command that did not end as it must.

    Attributes:
        command: ``branch.operation:ending``, with the check or step that ends it.
        before: The joint state in which it was asked.
        expected: What must come of it.
        found: What came of it.
    """

    command: str
    before: str
    expected: str
    found: str

    def __str__(self) -> str:
        return f"{self.command} in {self.before}: expected {self.expected}, found {self.found}"


def coverage(blueprint: Blueprint, done: Iterable[Move], wanted: Iterable[Move]) -> dict[str, Count]:
    """Count what `done` covers of `wanted` and of all that the blueprint declares, by the keys of `MEANINGS`."""
    covered, total = set(_counted(done)), set(_counted(wanted)) | set(_declared(blueprint))
    return {
        key: Count(sum(of == key for of, _ in covered & total), sum(of == key for of, _ in total)) for key in MEANINGS
    }


def is_complete(counts: dict[str, Count]) -> bool:
    """Whether nothing is left."""
    return all(count.covered == count.total for count in counts.values())


def deviation(blueprint: Blueprint, move: Move, decision: str, after: Joint, code: str) -> Deviation | None:
    """What is not as it must be in what came of a move, if anything; `code` is compared where the move has one."""
    as_told = decision == move.decision and after == move.after and move.code in ("", code)
    if as_told:
        return None
    expected, found = (
        f"{said}{f' ({why})' * bool(why)} and {line_of(branch_states(blueprint, joint))}"
        for said, why, joint in ((move.decision, move.code, move.after), (decision, code, after))
    )
    before = line_of(branch_states(blueprint, move.before))
    return Deviation(command=str(move), before=before, expected=expected, found=found)


def _counted(moves: Iterable[Move]) -> Iterator[tuple[str, object]]:
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
    """Outcomes count although no joint state may ever give them."""
    for branch, operation, spec in operations(blueprint):
        if not spec.iio:
            yield from (("outcomes", (f"{branch}.{operation}", outcome)) for outcome in spec.endings)
