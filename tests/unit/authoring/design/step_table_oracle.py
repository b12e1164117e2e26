"""Random step tables, and what they mean stated naively: a set of steps done, without branches or states."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any


@dataclass
class Step:
    """A step; those that refine it are below it."""

    name: str
    needs: set[str]
    below: list[Step] = field(default_factory=list)
    above: Step | None = None
    beside: list[Step] = field(default_factory=list)

    def leaves(self) -> set[str]:
        return {self.name} if not self.below else set().union(*(step.leaves() for step in self.below))

    def achieved(self, done: set[str]) -> bool:
        return self.leaves() <= done

    def possible(self, done: set[str]) -> bool:
        needed = all(step.achieved(done) for step in self.beside if step.name in self.needs)
        return needed and (self.above is None or self.above.possible(done))

    def resting_on_it(self) -> set[str]:
        """Leaves of the steps that depend on it, directly or not, or on the step that it refines."""
        found = {self.name}
        for _ in self.beside:
            found |= {step.name for step in self.beside if step.needs & found}
        leaves: set[str] = set().union(*(s.leaves() for s in self.beside if s.name in found - {self.name}))
        return leaves | (self.above.resting_on_it() if self.above else set())


class Model:
    """A procedure as a set of steps done."""

    def __init__(self, table: dict[str, Any]) -> None:
        self.roots = _steps(table["steps"], None)
        self.steps = {step.name: step for step in _all(self.roots)}

    def command(self, done: set[str], operation: str, outcome: str) -> set[str] | None:
        """The steps done after a command such as ``do_a``; None where it must be rejected."""
        word, _, name = operation.partition("_")
        step = self.steps[name]
        if word == "undo":
            return done - {name} - step.resting_on_it() if name in done else None
        if not step.possible(done) or (word == "try" and name in done):
            return None
        return done if outcome == "partial" else (done | {name}) - step.resting_on_it()

    def reinit(self, done: set[str], steps: Iterable[str]) -> set[str]:
        """The steps done after some, a branch, are begun again."""
        for name in steps:
            if self.steps[name].leaves() & done:
                done = done - self.steps[name].leaves() - self.steps[name].resting_on_it()
        return done


def random_table(rng: Random, *, levels: int, steps: int = 4) -> dict[str, Any]:
    """A table in which each step ``x`` is achieved by ``do_x``, and some by ``try_x``, and taken back by ``undo_x``."""
    names = (f"s{i}" for i in range(1000))
    return {"id": "random_table", "version": "1", "steps": _random_steps(rng, names, levels, steps)}


def _random_steps(rng: Random, names: Iterator[str], levels: int, most: int) -> list[dict[str, Any]]:
    made: list[dict[str, Any]] = []
    for _ in range(rng.randint(1, most)):
        name = next(names)
        needs = [step["name"] for step in made if rng.random() < 0.4]
        step: dict[str, Any] = {"name": name, "operation": f"do_{name}", "depends_on": needs}
        if levels > 1 and rng.random() < 0.5:
            below = _random_steps(rng, names, levels - 1, 3)
            step |= {"operation": f"signal_{name}", "refined_by": {"branch": f"inside_{name}", "steps": below}}
        else:
            step |= {"moves": False, "reopened_by": [f"undo_{name}"]}
            step |= {"alternatives": [{"operation": f"try_{name}", "partial": True}]} if rng.random() < 0.3 else {}
        made.append(step)
    # The table need not name what a step depends on before the step.
    rng.shuffle(made)
    return made


def _steps(table: list[dict[str, Any]], above: Step | None) -> list[Step]:
    steps = [Step(each["name"], set(each["depends_on"]), above=above) for each in table]
    for step, each in zip(steps, table, strict=True):
        step.beside = steps
        step.below = _steps(each.get("refined_by", {}).get("steps", []), step)
    return steps


def _all(steps: list[Step]) -> Iterator[Step]:
    for step in steps:
        yield step
        yield from _all(step.below)
