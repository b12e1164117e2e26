"""The synchronous core: which operations a joint state accepts, and where they lead. No journal, steps or locks."""

from __future__ import annotations

from collections.abc import Mapping

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.branch import StateSet
from pcmrs.fsm.closure import Change, Closure, Denial, close

Answers = dict[tuple[str, str], Closure | Denial]


class Engine:
    """One workflow and the joint state it is in.

    The active state object of a branch is asked for each operation; since its answer and the closure depend on
    the joint state only, they are worked out once for each.
    """

    def __init__(self, blueprint: Blueprint) -> None:
        self.blueprint = blueprint
        self._states = StateSet(blueprint)
        self._answers: dict[tuple[str, ...], Answers] = {}
        self._here = self._answers_in(self._states.joint())

    def joint(self) -> dict[str, str]:
        """The joint state: branch to state."""
        return self._states.joint()

    def ask(self, branch: str, operation: str) -> Closure | Denial:
        """What the operation would change now, or why it is not allowed.

        Raises:
            KeyError: There is no such branch or operation.
        """
        try:
            return self._here[branch, operation]
        except KeyError:
            return self.ask_in(self._states.joint(), branch, operation)

    def ask_in(self, states: Mapping[str, str], branch: str, operation: str) -> Closure | Denial:
        """The same for any joint state: the state object of the branch is asked, then the closure worked out."""
        answers = self._answers_in(states)
        if (branch, operation) not in answers:
            answer = self._states.objects[branch][states[branch]].ask(operation)
            if isinstance(answer, Denial):
                answers[branch, operation] = answer
            else:
                answers[branch, operation] = close(self.blueprint, states, branch, operation)
        return answers[branch, operation]

    def allowed(self, branch: str, states: Mapping[str, str] | None = None) -> list[str]:
        """Operations of a branch that users may ask for and would not be denied, in the blueprint's order."""
        joint = self._states.joint() if states is None else states
        operations = self.blueprint.branches[branch].operations
        asked = (name for name, spec in operations.items() if not spec.iio and not spec.event)
        return [name for name in asked if isinstance(self.ask_in(joint, branch, name), Closure)]

    def perform(self, branch: str, operation: str, outcome: str | None = None) -> Change | Denial:
        """Performs an operation at once.

        Args:
            branch: The branch asked.
            operation: One of its operations.
            outcome: A declared outcome, ``failed`` or ``unknown``; may be left out where one outcome is possible.

        Returns:
            What has changed, or why nothing has. An operation that fails and stays where it is changes nothing.

        Raises:
            KeyError: There is no such branch, operation or outcome here.
        """
        closure = self.ask(branch, operation)
        if isinstance(closure, Denial):
            return closure
        change = self._ending(closure, outcome)
        self.apply(change)
        return change

    def apply(self, change: Change) -> None:
        """Commits a change: all its branches move together."""
        self.place(change.targets)

    def place(self, states: Mapping[str, str]) -> None:
        """Puts the named branches into states, all together.

        Raises:
            KeyError: A branch or state does not exist; nothing has moved.
        """
        self._states.transition(states)
        self._here = self._answers_in(self._states.joint())

    def _ending(self, closure: Closure, outcome: str | None) -> Change:
        if outcome in ("failed", "unknown"):
            change = closure.failure if outcome == "failed" else closure.unknown
            return change or Change(self._states.joint(), ())
        if outcome is None and len(closure.outcomes) == 1:
            return next(iter(closure.outcomes.values()))
        return closure.outcomes[outcome or ""]

    def _answers_in(self, states: Mapping[str, str]) -> Answers:
        return self._answers.setdefault(tuple(states[branch] for branch in self.blueprint.branches), {})
