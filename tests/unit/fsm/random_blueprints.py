"""Random small workflows that obey the static rules; most are sound enough to run, many break some property."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from hypothesis import strategies as st

from pcmrs.fsm.blueprint import (
    Blueprint,
    BranchSpec,
    OperationSpec,
    OutcomeSpec,
    ParentSpec,
    Requirement,
    RevocationSpec,
    TransitionTarget,
)

NAMES = ("alpha", "beta", "gamma", "delta")


def random_blueprint(rng: Random, *, plain: bool = False) -> Blueprint:
    """A workflow of 1 to 4 branches of 1 to 4 states, up to 3 levels deep.

    Args:
        rng: Where it comes from; the same generator gives the same workflow.
        plain: All branches are roots and every operation has only `from` and `to`.
    """
    return _Maker(rng, plain).blueprint()


def blueprints(*, plain: bool = False) -> st.SearchStrategy[Blueprint]:
    """The same as a strategy."""
    return st.randoms(use_true_random=False).map(lambda rng: random_blueprint(rng, plain=plain))


@dataclass
class _Maker:
    rng: Random
    plain: bool

    def blueprint(self) -> Blueprint:
        names = NAMES[: self.rng.randint(1, len(NAMES))]
        self.states = {name: [f"s{i}" for i in range(self.rng.choice([1, 2, 2, 3, 3, 4]))] for name in names}
        self.parents: dict[str, str | None] = {}
        self.levels: dict[str, int] = {}
        for name in names:
            above = [other for other in self.levels if self.levels[other] < 3]
            nested = bool(above) and not self.plain and self.rng.random() < 0.6
            self.parents[name] = parent = self.rng.choice(above) if nested else None
            self.levels[name] = 1 if parent is None else self.levels[parent] + 1
        branches = {name: self.branch(name) for name in names}
        goal = self.requirement() if self.rng.random() < 0.3 else {}
        return Blueprint(id="random", version="1.0.0", branches=branches, goal=goal)

    def branch(self, name: str) -> BranchSpec:
        states, parent = self.states[name], self.parents[name]
        operations = {f"go_{i}": self.operation(name) for i in range(self.rng.randint(1, 4))}
        if parent is not None or (not self.plain and self.rng.random() < 0.3):
            operations["reinit"] = OperationSpec(from_=["*"], to=states[0], rio=True)
        if name in self.parents.values():
            operations.update({f"called_{i}": self.called(name) for i in range(2)})
        return BranchSpec(
            level=self.levels[name],
            states={state: f"{name} {state}" for state in states},
            operations=operations,
            parent=None if parent is None else self.parent(name, parent),
            emits={} if parent is None else {state: f"called_{self.rng.randrange(2)}" for state in states},
            revocations=self.revocations(name),
        )

    def operation(self, branch: str) -> OperationSpec:
        source = self.sources(branch)
        if self.plain:
            return OperationSpec(from_=source, to=self.target(branch, source))
        rng, ends = self.rng, self.outcomes(branch, source)
        steps = rng.random() < 0.5  # what has none can neither fail nor leave doubt
        return OperationSpec(
            from_=source,
            to=None if ends else self.target(branch, source),
            outcomes=ends,
            requires=self.requirement() if rng.random() < 0.3 else {},
            sets=self.sets(branch),
            signals=rng.random() < 0.2,
            event=rng.random() < 0.1,
            steps=["work"] if steps else [],
            on_failure=self.target(branch, source) if steps and rng.random() < 0.4 else None,
            on_unknown=self.target(branch, source) if steps and rng.random() < 0.4 else None,
        )

    def outcomes(self, branch: str, source: list[str]) -> dict[str, OutcomeSpec]:
        return {} if self.rng.random() < 0.75 else {name: self.outcome(branch, source) for name in ("well", "badly")}

    def outcome(self, branch: str, source: list[str]) -> OutcomeSpec:
        requires = self.requirement() if self.rng.random() < 0.3 else {}
        return OutcomeSpec(to=self.target(branch, source), requires=requires)

    def called(self, branch: str) -> OperationSpec:
        source = ["*"] if self.rng.random() < 0.6 else self.sources(branch)
        return OperationSpec(from_=source, to=self.target(branch, source), iio=True)

    def sources(self, branch: str) -> list[str]:
        return ["*"] if self.rng.random() < 0.25 else self.some(self.states[branch])

    def target(self, branch: str, source: list[str]) -> TransitionTarget:
        states = self.states[branch]
        if self.rng.random() < 0.75:
            return self.rng.choice(states)
        return {state: self.rng.choice(states) for state in (states if source == ["*"] else source)}

    def requirement(self) -> Requirement:
        branch = self.rng.choice(list(self.states))
        return {branch: self.some(self.states[branch])}

    def sets(self, branch: str) -> dict[str, str]:
        children = [name for name, parent in self.parents.items() if parent == branch]
        if not children or self.rng.random() < 0.8:
            return {}
        child = self.rng.choice(children)
        return {child: self.rng.choice(self.states[child])}

    def parent(self, child: str, parent: str) -> ParentSpec:
        above = self.states[parent]
        start = self.rng.choice(above)
        fits = {state: self.some(above, at_least=len(above) // 2) for state in self.states[child]}
        first = self.states[child][0]
        fits[first] = [state for state in above if state in {*fits[first], start, above[0]}]
        return ParentSpec(branch=parent, start=start, compatible=fits)

    def revocations(self, branch: str) -> list[RevocationSpec]:
        others = [name for name in self.states if name != branch]
        if self.plain or not others or self.rng.random() < 0.7:
            return []
        source = self.some(self.states[branch])
        return [RevocationSpec(by=self.some(others), from_=source, to=self.rng.choice(self.states[branch]))]

    def some(self, things: list[str], at_least: int = 1) -> list[str]:
        chosen = set(self.rng.sample(things, self.rng.randint(max(1, at_least), len(things))))
        return [thing for thing in things if thing in chosen]
