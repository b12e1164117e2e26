"""Operations that take time: can each be concluded wherever it, or Stop, may end it?"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

from pcmrs.fsm.closure import Closure
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.verify.decisions import Decisions
from pcmrs.fsm.verify.moments import Moments
from pcmrs.fsm.verify.observed import Decision
from pcmrs.fsm.verify.search import Progress
from pcmrs.fsm.verify.space import Space
from pcmrs.fsm.verify.structure import path_of
from pcmrs.fsm.verify.work import Work


class Runs:
    """What can be said of a workflow whose operations take time.

    An operation is asked again when it ends, in the joint state of then. Its locks keep the branches that it
    depended on when it began; only one that looks at other branches too can find itself denied. For all others
    nothing has to be searched.

    Args:
        space: The joint states.
        progress: Told now and then how many moments have been looked at, and how many are known.

    Attributes:
        work: What the searches may still cost.
    """

    def __init__(self, space: Space, progress: Progress | None = None) -> None:
        self.space = space
        self.work = Work(space.limit, progress, len(space.reached))

    def moments(self, observed: frozenset[str]) -> Moments:
        """What can be while these operations are watched. Raises `TooManyError`."""
        return Moments(self.space, observed, self.work)

    @cached_property
    def strandable(self) -> list[str]:
        """Operations that, as far as their locks tell, might end where they are denied."""
        lasting = [operation for operation in self.space.operations if operation.spec.steps]
        return [operation.name for operation in lasting if _may_be_denied_at_its_end(operation)]


def stranded(moments: Moments, name: str) -> Iterator[Finding]:
    """The one operation watched can be found, when it ends, where none of its endings is allowed."""
    code = moments.reached.first(moments.stranded)
    if code is not None:
        text = f"{name} cannot be concluded in {moments.shown(code)}: it is denied there, whatever its ending."
        yield Finding(code="cannot_conclude", text=text, path=path_of(name), commands=moments.way_to(code))


def _may_be_denied_at_its_end(operation: Decisions) -> bool:
    """Whether it may begin somewhere and be denied somewhere else, its locked branches being the same in both."""
    begun = [decision for decision in operation.known if isinstance(decision.answer, Closure)]
    denied = [decision for decision in operation.known if not isinstance(decision.answer, Closure)]
    return any(_alike(one, other) for one in begun for other in denied)


def _alike(begun: Decision, denied: Decision) -> bool:
    locked = begun.answer.writes | begun.answer.reads if isinstance(begun.answer, Closure) else frozenset()
    both = locked & begun.seen.keys() & denied.seen.keys()
    return all(begun.seen[branch] == denied.seen[branch] for branch in both)
