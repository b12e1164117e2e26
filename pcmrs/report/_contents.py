"""Contents of a report, as plain data."""

from __future__ import annotations

from typing import Literal

import msgspec

from pcmrs.messages import BlueprintTag, PoseMessage

Decision = Literal["accepted", "rejected", "failed", "unknown"]
EventKind = Literal["stop", "fault", "notice"]
"""``stop``: Stop was requested; ``fault``: a device or the daemon reported a danger; ``notice``: another report."""


class ReportedRun(msgspec.Struct, frozen=True, kw_only=True):
    """One run of the daemon.

    Attributes:
        session: Id of the session in the journal.
        begun: Time of its first row, Unix seconds.
        ended: Time of its last row, Unix seconds.
        in_order: True if it ended in order; False if it was killed, or still ran when the journal was read.
        patient: Patient id in its settings.
        first: Sequence of its first row.
        last: Sequence of its last row.
    """

    session: str
    begun: float
    ended: float
    in_order: bool
    patient: str
    first: int
    last: int


class ReportedGate(msgspec.Struct, frozen=True, kw_only=True):
    """One acceptance test of a registration; the unit depends on its name, lengths are in m."""

    name: str
    accepted: bool
    value: float
    limit: float


class ReportedLandmark(msgspec.Struct, frozen=True, kw_only=True):
    """A landmark of a registration, and its distance from the planned point after the fit."""

    name: str
    distance_mm: float


class ReportedRegistration(msgspec.Struct, frozen=True, kw_only=True):
    """A registration that was put in force.

    Attributes:
        sequence: Sequence of its row.
        wall: Time of its row, Unix seconds.
        operation: Operation: ``register``, ``refine``, ``use_previous``.
        residual_mm: Mean distance of the landmarks.
        residual_limit_mm: Limit of the mean distance; None if it is unknown.
        tre_mm: Target registration error predicted at `target`, rms.
        target: ``plan`` or ``centroid``.
        id: Id in the journal.
    """

    sequence: int
    wall: float
    operation: str
    residual_mm: float | None
    rms_mm: float | None
    residual_limit_mm: float | None
    tre_mm: float | None
    tre_limit_mm: float | None
    target: str
    landmarks: tuple[ReportedLandmark, ...]
    gates: tuple[ReportedGate, ...]
    id: str


class ReportedPlan(msgspec.Struct, frozen=True, kw_only=True):
    """A planned pose, and the target registration error predicted there, rms."""

    sequence: int
    wall: float
    operation: str
    tre_mm: float | None


class ReportedPlacement(msgspec.Struct, frozen=True, kw_only=True):
    """A measurement of the tool against its planned pose.

    Attributes:
        operation: Operation that measured, such as ``placement.confirm``.
        error_mm: Translation error in the journal.
        error_deg: Rotation error in the journal.
        axes_mm: Translation error in the measured tool's axes; None if the journal lacks the poses.
        planned: ``image_from_tool``; None if the journal lacks it.
        measured: ``image_from_tool``; None if the journal lacks it.
        standoff: Distance along the tool's z axis at which it was to stop before the planned pose, m.
    """

    sequence: int
    wall: float
    operation: str
    error_mm: float
    error_deg: float
    axes_mm: tuple[float, float, float] | None
    planned: PoseMessage | None
    measured: PoseMessage | None
    standoff: float


class AcceptedOperation(msgspec.Struct, frozen=True, kw_only=True):
    """An operation that was accepted.

    Attributes:
        title: Title in its workflow.
        times: Number of times it was accepted.
        acts: True if it acts on the patient without moving the robot; None if the workflow is not installed here.
    """

    operation: str
    title: str
    times: int
    acts: bool | None


class ReportedRefusal(msgspec.Struct, frozen=True, kw_only=True):
    """An operation that was not accepted, for one reason.

    Attributes:
        sequence: Sequence of the first row.
        wall: Time of the first row, Unix seconds.
        times: Number of times.
        checked: True if a check examined arguments, data or devices; False if it came at a wrong time or from a wrong
            sender.
        advice: What to do.
    """

    sequence: int
    wall: float
    operation: str
    who: str
    decision: Decision
    code: str
    text: str
    advice: str
    checked: bool
    times: int


class ReportedUnknownOutcome(msgspec.Struct, frozen=True, kw_only=True):
    """An operation that started and whose outcome is unknown.

    Attributes:
        wall: Time at which this was found, Unix seconds.
        settled: True if an operator has checked it since; None if the workflow is not installed here.
    """

    sequence: int
    wall: float
    operation: str
    text: str
    settled: bool | None


class ReportedEvent(msgspec.Struct, frozen=True, kw_only=True):
    """An event that a device or the daemon reported, `times` in a row."""

    sequence: int
    wall: float
    kind: EventKind
    source: str
    code: str
    text: str
    times: int


class TimelineEntry(msgspec.Struct, frozen=True, kw_only=True):
    """A line of the timeline.

    Attributes:
        what: Operation or event.
        outcome: Decision, or kind of the event.
        state: State of the branch afterwards; empty for events.
        text: Reason, or text of the event.
        times: Number of times in a row.
    """

    sequence: int
    wall: float
    what: str
    who: str
    outcome: str
    state: str
    text: str
    times: int


class StateSpan(msgspec.Struct, frozen=True, kw_only=True):
    """A state of a branch with its start and end, Unix seconds."""

    state: str
    begun: float
    ended: float


class ReportedBranch(msgspec.Struct, frozen=True, kw_only=True):
    """A branch of the workflow and its states over time.

    Attributes:
        states: State to its meaning; empty if the workflow is not installed here.
        final: Last state.
    """

    name: str
    title: str
    states: dict[str, str]
    spans: tuple[StateSpan, ...]
    final: str


class ReportedJournal(msgspec.Struct, frozen=True, kw_only=True):
    """Result of the verification of the journal.

    Attributes:
        name: Name of its file.
        rows: Number of rows that could be read, from the first on.
        problems: Problems, one sentence each; empty if it is sound.
        proven: Number of rows that its signature proves.
        last_hash: Hash of the last row, hexadecimal.
        key: SHA-256 of the public key's file; empty if there is none.
    """

    name: str
    rows: int
    problems: tuple[str, ...]
    signature: str
    proven: int
    last_hash: str
    key: str


class ReportedFile(msgspec.Struct, frozen=True, kw_only=True):
    """A file of the session.

    Attributes:
        note: Problem of the file; empty if none is known.
        wrong: True if the file is missing, or differs from the exported one.
    """

    name: str
    size: int
    sha256: str
    note: str
    wrong: bool = False


class SessionReport(msgspec.Struct, frozen=True, kw_only=True):
    """One session.

    Attributes:
        patient: Patient id; empty if it is not set.
        operator: Operator id; empty if it is not set.
        named: Persons named in commands, such as the surgeon.
        asked: Users who asked for operations, with their roles.
        title: Title of the workflow.
        known: True if exactly that workflow is installed here; otherwise titles and meanings are missing.
        devices: Device to its driver.
        rate: Seconds of the cell per second of the machine; None if it is unknown.
        earlier: Number of sessions in the journal before this one.
        later: Number of sessions in the journal after this one.
        asked_for: Number of operations that were asked for.
        counts: Decision to the number of operations.
        latched: True if a Stop was still latched at the end; None if the workflow is not installed here.
        changed: Settings that differ from the defaults of this version.
    """

    patient: str
    operator: str
    named: tuple[str, ...]
    asked: tuple[str, ...]
    workflow: BlueprintTag
    title: str
    known: bool
    devices: dict[str, str]
    rate: float | None
    begun: float
    ended: float
    runs: tuple[ReportedRun, ...]
    earlier: int
    later: int
    journal: ReportedJournal
    asked_for: int
    counts: dict[str, int]
    registrations: tuple[ReportedRegistration, ...]
    plans: tuple[ReportedPlan, ...]
    placements: tuple[ReportedPlacement, ...]
    done: tuple[AcceptedOperation, ...]
    refusals: tuple[ReportedRefusal, ...]
    unknown: tuple[ReportedUnknownOutcome, ...]
    events: tuple[ReportedEvent, ...]
    latched: bool | None
    branches: tuple[ReportedBranch, ...]
    timeline: tuple[TimelineEntry, ...]
    calibration: str
    versions: dict[str, str]
    reported_by: str
    changed: tuple[str, ...]
    files: tuple[ReportedFile, ...]

    @property
    def simulated(self) -> bool:
        """True if all drivers are simulated."""
        return bool(self.devices) and set(self.devices.values()) == {"sim"}

    @property
    def problems(self) -> tuple[str, ...]:
        """Problems of the journal and of the files."""
        return (*self.journal.problems, *(f"{file.name} {file.note}." for file in self.files if file.wrong))

    def events_of(self, kind: EventKind) -> tuple[ReportedEvent, ...]:
        """Return the events of one kind."""
        return tuple(event for event in self.events if event.kind == kind)
