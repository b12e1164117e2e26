"""What a test tour has shown of a workflow: how much was covered, what was otherwise, and what was left out."""

from __future__ import annotations

import msgspec

from pcmrs.authoring.trial.coverage import Count, Deviation


class Left(msgspec.Struct, frozen=True):
    """An ending of an operation that was not seen, in how many joint states, and why."""

    command: str
    joint_states: int
    reason: str


class TourReport(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a test tour.

    Attributes:
        subjects: What was tested, and how many commands each was given.
        joint_states: How many there are.
        restarts: How often the workflow was started anew on the way.
        stops: How often Stop was pressed.
        events: How often a device reported something by itself.
        seconds: How long it took, s of the machine.
        coverage: What of the workflow was seen to be as it must, by the keys of
            `pcmrs.authoring.trial.coverage.MEANINGS`.
        deviations: What was not, by subject.
        left: What could not be seen.
        passed: Nothing deviates, and every operation was seen in every joint state.
    """

    workflow: str
    version: str
    hash: str
    subjects: dict[str, int]
    joint_states: int
    restarts: int = 0
    stops: int = 0
    events: int = 0
    seconds: float
    coverage: dict[str, Count]
    deviations: dict[str, list[Deviation]]
    left: list[Left] = []
    passed: bool
