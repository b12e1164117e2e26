"""Base of the state classes that are generated from a blueprint."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from pcmrs.fsm.closure import Answer, Denial

__all__ = ["Answer", "State"]


class State:
    """Root of all branch and state classes.

    The class of a branch holds a method for each of its operations, which refuses; a state is a class derived
    from it that overrides the operations that are valid there.

    Attributes:
        branch: Name of the State Branch.
        name: Digits or name of the state; empty on a branch's class.
        meaning: Meaning of the state, for people.
    """

    branch: ClassVar[str] = ""
    name: ClassVar[str] = ""
    meaning: ClassVar[str] = ""

    def __init__(self) -> None:
        self.active = False

    def activate(self) -> None:
        """Make this the active state of its branch."""
        self.active = True

    def deactivate(self) -> None:
        """Leave this state."""
        self.active = False

    def ask(self, operation: str) -> Answer:
        """Call the operation's method on this object: the state's own, or the branch's refusal."""
        method: Callable[[], Answer] = getattr(self, operation)
        return method()

    def refuse(self, operation: str) -> Denial:
        """Return why an operation that this state does not override is not valid in it."""
        text = f"{self.branch} is in {self.name} ({self.meaning}), which does not allow {operation}."
        return Denial("invalid_in_state", text, {"branch": self.branch, "state": self.name, "operation": operation})
