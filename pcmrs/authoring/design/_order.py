"""The dependency order of the steps of one branch, and the combinations of achieved steps that respect it.

A combination is a set of steps as the bits of an integer. The possible ones are the order ideals of the
dependencies, also called downward closed sets: with each step they contain all its dependencies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from pcmrs.authoring.design.tables import StepSpec

MAX_COMBINATIONS = 4096
"""A branch with more states than this cannot be reviewed."""


class TooManyCombinationsError(Exception):
    """The steps of one branch allow over `MAX_COMBINATIONS` combinations."""


class Order:
    """The steps of one branch, with their dependencies.

    Attributes:
        steps: Steps in the order of the table.
        needs: For each step, the steps it directly depends on, as bits.
        dependents: For each step, all that depend on it, directly or not, as bits.
        ideals: The possible combinations, the empty one first.
        combinations: The states of the branch, the start first.
        flags: Meaning of each digit of a state.

    Args:
        steps: Steps without cycles; all their dependencies are among them.

    Raises:
        TooManyCombinationsError: They have too few dependencies to make one branch.
    """

    def __init__(self, steps: Sequence[StepSpec]) -> None:
        self.steps = tuple(steps)
        self.index = {step.name: i for i, step in enumerate(steps)}
        self.needs = [sum(1 << self.index[name] for name in set(step.depends_on)) for step in steps]
        self.sequence = list(self._sorted())
        self.dependents = self._dependents()
        self.ideals = self._ideals()
        self.flags = [step.name for step in steps]
        self.combinations = self.ideals

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def all(self) -> int:
        """The combination of all steps."""
        return self._every

    def state(self, combination: int) -> str:
        """Return the digits of a combination in the order of the table, 1 for each step achieved."""
        return "".join("1" if combination >> i & 1 else "0" for i in range(len(self.flags)))

    def meaning(self, combination: int) -> str:
        """Return the achieved steps, in words."""
        achieved = [step.meaning for i, step in enumerate(self.steps) if combination >> i & 1]
        return ", ".join(achieved) or "nothing achieved yet"

    def possible(self, step: int, combination: int) -> bool:
        """Return true if all that the step depends on is achieved.

        Args:
            step: Index of the step.
            combination: Steps achieved, as bits.
        """
        return not self.needs[step] & ~combination

    def possible_at(self, step: int) -> Iterator[int]:
        """Return the combinations in which the step can be done."""
        return (each for each in self.combinations if self.possible(step, each))

    def reopenable(self, step: int, combination: int) -> bool:
        """Return true if the step can be taken back.

        Args:
            step: Index of the step.
            combination: Steps achieved, as bits.
        """
        return bool(combination >> step & 1)

    def achieve(self, step: int, combination: int) -> int:
        """Return the combination after doing the step: what depends on it is open again.

        Args:
            step: Index of the step.
            combination: Steps achieved before, as bits.
        """
        return (combination | 1 << step) & ~self.dependents[step]

    def reopen(self, step: int, combination: int) -> int:
        """Return the combination after taking the step back, and all that depends on it.

        Args:
            step: Index of the step.
            combination: Steps achieved before, as bits.
        """
        return combination & ~(1 << step | self.dependents[step])

    def first_possible(self, step: int) -> int:
        """Return the smallest combination in which the step can be done."""
        closed = self.needs[step]
        for i in reversed(self.sequence):
            if closed >> i & 1:
                closed |= self.needs[i]
        return closed

    @property
    def _every(self) -> int:
        return (1 << len(self)) - 1

    def _sorted(self) -> Iterator[int]:
        """Return the steps after all they depend on, else in the order of the table."""
        done = 0
        while done != self._every:
            step = next(i for i, needs in enumerate(self.needs) if not done >> i & 1 and not needs & ~done)
            done |= 1 << step
            yield step

    def _dependents(self) -> list[int]:
        found = [0] * len(self)
        for step in reversed(self.sequence):
            for i in range(len(self)):
                if self.needs[step] >> i & 1:
                    found[i] |= 1 << step | found[step]
        return found

    def _ideals(self) -> list[int]:
        """Each step in turn joins those combinations that hold all it depends on."""
        found = [0]
        for step in self.sequence:
            found += [each | 1 << step for each in found if not self.needs[step] & ~each]
            if len(found) > MAX_COMBINATIONS:
                raise TooManyCombinationsError
        return found
