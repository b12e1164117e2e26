"""Result of a test tour of a workflow: coverage, deviations, and responses that were left out."""

from __future__ import annotations

import msgspec

from pcmrs.authoring.trial.coverage import CoverageCount, Deviation


class Left(msgspec.Struct, frozen=True):
    """Ending of an operation that was not covered, with the number of joint states and the reason."""

    command: str
    joint_states: int
    reason: str


class TourReport(msgspec.Struct, frozen=True, kw_only=True):
    """Result of a test tour.

    Attributes:
        subjects: Subjects of the test, with the number of commands that each received.
        joint_states: Number of joint states.
        restarts: Number of restarts of the workflow during the tour.
        stops: Number of Stops that were pressed.
        events: Number of events that devices reported by themselves.
        seconds: Duration, s of the machine.
        coverage: Covered responses of the workflow, by the keys of `pcmrs.authoring.trial.coverage.MEANINGS`.
        deviations: Deviations by subject.
        left: Responses that could not be covered.
        passed: True if nothing deviates, and every operation was covered in every joint state.
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
    coverage: dict[str, CoverageCount]
    deviations: dict[str, list[Deviation]]
    left: list[Left] = []
    passed: bool
