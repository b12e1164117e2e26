"""A workflow as data: branches, states and operations, as a blueprint file declares them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Annotated, Any, Literal

import msgspec

from pcmrs.messages.identity import COMMANDING, Role

__all__ = [
    "START_OUTCOME",
    "ActivitySpec",
    "Blueprint",
    "BranchSpec",
    "Condition",
    "MigrationSpec",
    "OperationSpec",
    "OutcomeSpec",
    "ParentSpec",
    "PropertySpec",
    "ProvenanceSpec",
    "RevocationSpec",
    "SequenceSpec",
    "StageSpec",
    "TimerSpec",
]

Motion = Literal["none", "approach", "retreat"]

Requirement = dict[str, list[str]]
"""Branch to the states it may be in."""

TransitionTarget = str | dict[str, str]
"""The target state, or a target state for each source state."""

UNMET = "requirement_not_met"
"""Code of the rejection when a requirement without its own code does not hold."""

ROBOT = "robot"
"""Name of the branch that connects the robot."""

START_OUTCOME = "done"
"""Name of the only outcome of an operation that declares none."""


class BlueprintPart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all parts of a blueprint; unknown keys are refused when it is read."""


def target_from(target: TransitionTarget, source: str) -> str:
    """Return the state that `target` means, coming from `source`.

    Args:
        target: Target of an operation.
        source: State that the branch is in before it.
    """
    return target if isinstance(target, str) else target[source]


class OutcomeSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One declared way an operation ends.

    Attributes:
        to: Target state.
        requires: Condition for taking this outcome.
        revoked_to: Branch to the state that a revocation by this outcome takes it to, in place of the rule's own `to`.
            Left out if the outcome revokes as the rules say.
    """

    to: TransitionTarget
    requires: Requirement = {}
    # Not an empty table: what is unset is not encoded, so the hashes of workflows without it stay as they were.
    revoked_to: dict[str, str] | msgspec.UnsetType = msgspec.UNSET

    @property
    def diverted(self) -> dict[str, str]:
        """`revoked_to`, empty if it is left out."""
        return {} if self.revoked_to is msgspec.UNSET else self.revoked_to


class OperationSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"from_": "from"}):
    """One operation of a branch (SO); changing (SCO) or maintaining (SMO) by its `from` and target.

    Attributes:
        title: Its effect, in the words of its users.
        from_: States it is valid in; ``["*"]`` for all.
        to: Target state; an operation has either this or `outcomes`.
        outcomes: Declared endings with their own targets, chosen by its last step.
        payload: Registered name of its arguments' type.
        checks: Registered names of pure checks; a refusal there is a rejection.
        steps: Registered names of steps, in order; a refusal there is a failure.
        timeout_s: Deadline for all steps together, in s of the cell's clock.
        requires: Condition that must hold while it runs.
        refusal: Code of the rejection when `requires` does not hold, or one for each branch in it.
        roles: Roles that may ask for it; empty for all roles that may ask for operations.
        moves: It moves the robot.
        motion: Direction of its motion. If only `moves` is given, it counts as an approach.
        affects_patient: It acts on the patient without moving the robot, as drilling does: refused while Stop is
            latched, and never kept waiting for others, as motions are.
        blocked_when_latched: The latch of Stop forbids it. Filled when it is read: what moves or affects the patient is
            forbidden, and nothing else unless it says so.
        irreversible: Its effect cannot be undone: it is not accepted again before an operation that allows that.
        allows_again: Irreversible operations of the branch that may be done again after this one.
        confirm: A user must confirm it each time before it is accepted, in a branch that
            `pcmrs.fsm.files._confirming` makes from this. False once that is made.
        rio: It is the branch's re-initiation operation (RIO).
        iio: It is called by a child branch only (IIO).
        event: It is called by a device, detector or timer only.
        signals: It signals the parent also when the state is kept.
        unlatches: It releases the latch that Stop has set.
        sets: Child branch to state that it sets without calling an operation there.
        on_failure: Target if a step refuses, raises or is stopped; without one the state is kept.
        on_unknown: Target if its ending is unknown; without one the state is kept.
    """

    title: str = ""
    from_: list[str]
    to: TransitionTarget | None = None
    outcomes: dict[str, OutcomeSpec] = {}
    payload: str = "none"
    checks: list[str] = []
    steps: list[str] = []
    timeout_s: float = 5.0
    requires: Requirement = {}
    refusal: str | dict[str, str] = UNMET
    roles: list[Role] = []
    moves: bool = False
    motion: Motion = "none"
    affects_patient: bool = False
    blocked_when_latched: bool | None = None
    irreversible: bool = False
    allows_again: list[str] = []
    confirm: bool = False
    rio: bool = False
    iio: bool = False
    event: bool = False
    signals: bool = False
    unlatches: bool = False
    sets: dict[str, str] = {}
    on_failure: TransitionTarget | None = None
    on_unknown: TransitionTarget | None = None

    def __post_init__(self) -> None:
        if self.moves and self.motion == "none":
            msgspec.structs.force_setattr(self, "motion", "approach")
        if self.blocked_when_latched is None:
            blocked = self.motion != "none" or self.affects_patient
            msgspec.structs.force_setattr(self, "blocked_when_latched", blocked)
        msgspec.structs.force_setattr(self, "moves", self.motion != "none")

    @property
    def implied(self) -> dict[str, Any]:
        """Keys that were added later, with the values that they have if they are not given."""
        blocked = self.moves or self.affects_patient
        later = {"irreversible": False, "allows_again": [], "confirm": False}
        return {"moves": self.moves, "blocked_when_latched": blocked} | later

    @property
    def allowed_roles(self) -> list[Role]:
        """Roles that may ask for it."""
        return [role for role in COMMANDING if not self.roles or role in self.roles]

    @property
    def endings(self) -> dict[str, OutcomeSpec]:
        """All declared outcomes; one named `START_OUTCOME` where only `to` is given."""
        if self.outcomes:
            return self.outcomes
        return {START_OUTCOME: OutcomeSpec(to=self.to or "")}

    @property
    def unconfirmed(self) -> dict[str, OutcomeSpec]:
        """Targets after an ending that was not declared, by ``failed`` and ``unknown``; only those that are given."""
        unconfirmed = {"failed": self.on_failure, "unknown": self.on_unknown}
        return {name: OutcomeSpec(to=target) for name, target in unconfirmed.items() if target is not None}

    def targets(self) -> set[str]:
        """Return every state it can lead to, by success, failure or doubt."""
        return _states_in([*self.endings.values(), *self.unconfirmed.values()])

    def declared_targets(self) -> set[str]:
        """Return every state that it leads to when it ends as declared."""
        return _states_in([*self.endings.values()])

    def unconfirmed_targets(self) -> set[str]:
        """Return every state that failure or doubt can lead to."""
        return _states_in([*self.unconfirmed.values()])


def _states_in(endings: list[OutcomeSpec]) -> set[str]:
    named = ([ending.to] if isinstance(ending.to, str) else ending.to.values() for ending in endings)
    return {state for states in named for state in states}


class ParentSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The state of a level N branch that this level N+1 branch refines.

    Attributes:
        branch: The parent.
        start: Parent state at which this branch starts (Rule 3).
        compatible: For each state here, the parent states it fits; ``"*"`` for all states not named.
    """

    branch: str
    start: str
    compatible: dict[str, list[str]]


class RevocationSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"from_": "from"}):
    """A change in one of the branches `by` takes this branch from `from` to `to` in the same commit."""

    by: list[str]
    from_: list[str]
    to: str


class SequenceSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Items that are performed in order; `pcmrs.fsm.files.sequence` makes the states and operations from it.

    Attributes:
        count: Number of items, or
        items: their names, in order.
        item: Name of one item of a counted sequence; items are ``<item>_1``, ``<item>_2`` …
        before: Name of a first state in which no item can be performed yet: the branch's own operation leads
            from it to the first item, and `reinit` leads back to it. Empty for none.
        perform: Further keys of the operation that performs an item; `from`, `to` and `on_failure` are made.
        skip: Further keys of the operation that leaves an item out.
        repeat: Further keys of the operation that opens a stopped item again.
        abandon: Further keys of the operation that ends the sequence.
    """

    count: int | None = None
    items: list[str] = []
    item: str = "point"
    before: str = ""
    perform: dict[str, Any] = {}
    skip: dict[str, Any] = {}
    repeat: dict[str, Any] = {}
    abandon: dict[str, Any] = {}


class ActivitySpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Function that runs while a branch is in a state: the do-activity of UML state machines, the `<invoke>` of SCXML.

    Attributes:
        run: Registered name of the function that runs from entering the state until it is left.
        ended: Event operation of the branch that leaves the state, performed when the activity ends by itself.
        moves: It moves the robot: Stop ends it, it does not begin while Stop is latched, and a motion takes over from
            it.
    """

    run: str
    ended: str
    moves: bool = False


class TimerSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Event that is posted when a branch has been in a state for some time: a time event of UML state machines.

    Attributes:
        states: States that it runs in: it begins when the branch enters one of them, and ends when that is left.
        after_s: Time from its beginning to its event, s of the cell's clock; or the name of the limit in the
            configuration, ``procedure.limits``, that has this time. The `defaults` of the workflow give that limit.
        posts: Event operation of the branch that is posted then.
        repeat: It begins again each time that operation is accepted in the same state.
        restarted_by: Operations, ``branch.operation``, each of which begins it again when it is accepted.
    """

    states: list[str]
    after_s: float | str
    posts: str
    repeat: bool = False
    restarted_by: list[str] = []

    @property
    def when(self) -> str:
        """Its time as UML writes a time event: ``after 600 s``, or ``after idle_s`` for a limit."""
        return f"after {self.after_s}" if isinstance(self.after_s, str) else f"after {self.after_s:g} s"

    def begins_again(self, branch: str) -> list[str]:
        """Return the operations, ``branch.operation``, that begin it again when they are accepted and keep its state.

        Args:
            branch: Its branch.
        """
        return [*self.restarted_by, *([f"{branch}.{self.posts}"] if self.repeat else [])]


class BranchSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One State Branch (SB).

    Attributes:
        level: 1 for a root workflow, N+1 for a branch that refines a state of level N.
        states: Name to meaning; the first is the start.
        sequence: In place of states: items that are performed in order. Empty once it is expanded.
        flags: Names of the digits of the states, mirrored for display.
        emits: For each state, the parent's operation called on a change to it (Rule 2); ``"*"`` for all not named.
        activities: State to the function that runs while the branch is in it.
        timers: Timers that run while the branch is in their states.
    """

    level: int = 1
    title: str = ""
    states: dict[str, str] = {}
    sequence: SequenceSpec | None = None
    operations: dict[str, OperationSpec] = {}
    flags: list[str] = []
    parent: ParentSpec | None = None
    emits: dict[str, str] = {}
    activities: dict[str, ActivitySpec] = {}
    timers: dict[str, TimerSpec] = {}
    revocations: list[RevocationSpec] = []

    @property
    def start(self) -> str:
        """The starting state."""
        return next(iter(self.states))

    @property
    def rio(self) -> str | None:
        """Name of the re-initiation operation, if there is one."""
        return next((name for name, operation in self.operations.items() if operation.rio), None)

    def timers_in(self, state: str) -> dict[str, TimerSpec]:
        """Return the timers that run while the branch is in a state."""
        return {name: timer for name, timer in self.timers.items() if state in timer.states}

    def valid_in(self, operation: str, state: str) -> bool:
        """Return true if the operation may be performed in the state.

        Args:
            operation: One of its operations.
            state: One of its states.
        """
        valid = self.operations[operation].from_
        return state in valid or valid == ["*"]


class Condition(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Condition on one moment of a procedure: all given parts must hold, and an empty condition always holds.

    Attributes:
        states: Each branch is in one of its states.
        running: One of these operations, ``branch.operation``, is running.
        accepted: Each of these operations would be accepted now; ``stop`` is Stop.
    """

    states: Requirement = {}
    running: list[str] = []
    accepted: list[str] = []


class PropertySpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A promise of the workflow, for the verifier to prove; exactly one of the four conditions is given.

    Attributes:
        id: Name of the property in findings.
        text: The promise in the words of its users.
        when: Only moments at which this holds are checked.
        always: Holds at every reachable moment.
        never: Holds at no reachable moment.
        reachable: Holds at some reachable moment.
        leads_to: From every reachable moment, a moment at which it holds can be reached.
    """

    id: str
    text: str = ""
    when: Condition = Condition()
    always: Condition | None = None
    never: Condition | None = None
    reachable: Condition | None = None
    leads_to: Condition | None = None


class StageSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A stage of the procedure, for guidance only: no decision depends on it.

    Attributes:
        id: Name of the stage in messages.
        title: Its purpose, in the words of its users.
        goal: It is reached while each branch is in one of its states.
        when: It belongs to the procedure only while this holds; always by default.
        operations: Operations, ``branch.operation``, that users should be led through, the first of several equally
            short ways first. An event among them is waited for.
    """

    id: str
    title: str = ""
    goal: Requirement
    when: Requirement = {}
    operations: list[str] = []


class MigrationSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An older blueprint of the same workflow whose journal may be continued under this one.

    Attributes:
        version: Version of the older blueprint.
        hash: Hash of the older blueprint.
        why: Why that is safe; not blank, since it goes into the journal.
    """

    version: str
    hash: str
    why: Annotated[str, msgspec.Meta(pattern=r"\S")]


class ProvenanceSpec(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Origin of a workflow that a language model has drafted: a daemon runs it only if a person has approved it.

    Attributes:
        model: Name of the model.
        prompt: SHA-256 of the first request to the model, hexadecimal.
        protocol: SHA-256 of the protocol's text, hexadecimal.
        date: Date of the draft, UTC, as ``2026-11-27``.
    """

    model: str
    prompt: str
    protocol: str
    date: str


class Blueprint(BlueprintPart, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """A whole workflow.

    Attributes:
        id: Name of the workflow.
        version: Its version, which journals and snapshots carry.
        goal: Joint states that must stay within reach: the purpose of the procedure.
        stage: Stages on the way to the goal, in their order; see `stages`.
        properties: Promises of the workflow.
        migrations: Older blueprints whose journals may be continued.
        defaults: Changes to the defaults of the configuration, such as limits.
        provenance: How a language model has drafted it: a daemon runs it only if a person has approved it. Left out if
            people have written it.
        hash: SHA-256 of its content, hexadecimal, whatever its comments, layout, migrations and stages; filled when it
            is read.
    """

    id: str
    version: str
    title: str = ""
    goal: Requirement = {}
    branches: dict[str, BranchSpec]
    properties: list[PropertySpec] = []
    migrations: list[MigrationSpec] = []
    defaults: dict[str, Any] = {}
    # Not an empty list: what is unset is not encoded, so the hashes of workflows do not depend on their stages.
    stage: list[StageSpec] | msgspec.UnsetType = msgspec.UNSET
    # Not None: what is unset is not encoded, so the hashes of workflows that people have written stay as they were.
    provenance: ProvenanceSpec | msgspec.UnsetType = msgspec.UNSET
    hash: str = ""

    def find(self, branch: str, operation: str) -> OperationSpec | None:
        """Return an operation by its names, or None if this version of the workflow has no such operation.

        Args:
            branch: Name of the branch.
            operation: Name of the operation.
        """
        known = self.branches.get(branch)
        return None if known is None else known.operations.get(operation)

    def initial(self) -> dict[str, str]:
        """The joint state at start: every branch in its starting state."""
        return {name: branch.start for name, branch in self.branches.items()}

    @property
    def declared_stages(self) -> list[StageSpec]:
        """The stages that it declares, in their order."""
        return [] if self.stage is msgspec.UNSET else self.stage

    @property
    def stages(self) -> list[StageSpec]:
        """Its stages in their order; one that is reached at the goal if it declares none."""
        implied = [StageSpec(id="goal", title=self.title, goal=self.goal)] if self.goal else []
        return self.declared_stages or implied

    @cached_property
    def guided(self) -> list[str]:
        """The operations, ``branch.operation``, that its stages name, in their order."""
        return list(dict.fromkeys(name for stage in self.declared_stages for name in stage.operations))

    @cached_property
    def roots(self) -> list[str]:
        """The branches that refine no other."""
        return [name for name, branch in self.branches.items() if branch.parent is None]

    @cached_property
    def children(self) -> dict[str, dict[str, ParentSpec]]:
        """For each branch, the branches that refine one of its states and how they fit it."""
        found: dict[str, dict[str, ParentSpec]] = {name: {} for name in self.branches}
        for name, branch in self.branches.items():
            if branch.parent is not None:
                found[branch.parent.branch][name] = branch.parent
        return found

    @cached_property
    def revocations_by(self) -> dict[str, list[tuple[str, RevocationSpec]]]:
        """For each branch whose change revokes states, the branches and rules that it applies to, in their order."""
        found: dict[str, list[tuple[str, RevocationSpec]]] = {}
        for name, branch in self.branches.items():
            for rule in branch.revocations:
                for by in dict.fromkeys(rule.by):
                    found.setdefault(by, []).append((name, rule))
        return found

    @cached_property
    def examined(self) -> dict[tuple[str, str], frozenset[str]]:
        """For each operation, the branches whose state decides on it: requirements and parents.

        A retreat must not wait for other branches: which of its outcomes can be taken is checked when it ends.
        """
        found: dict[tuple[str, str], frozenset[str]] = {}
        for name, branch in self.branches.items():
            above = frozenset(self._ancestors(name))
            for key, spec in branch.operations.items():
                ends = () if spec.motion == "retreat" else spec.endings.values()
                found[name, key] = above.union(spec.requires, *(ending.requires for ending in ends))
        return found

    def _ancestors(self, name: str) -> Iterator[str]:
        """Return the branch that a branch refines, and so on."""
        parent = self.branches[name].parent
        while parent is not None:
            yield parent.branch
            parent = self.branches[parent.branch].parent

    @cached_property
    def unlatching(self) -> list[str]:
        """The operations, ``branch.operation``, with which a user can release the latch that Stop has set."""
        return [
            f"{name}.{key}"
            for name, branch in self.branches.items()
            for key, operation in branch.operations.items()
            if operation.unlatches and not (operation.blocked_when_latched or operation.iio or operation.event)
        ]

    @cached_property
    def uses_robot(self) -> bool:
        """It connects or moves the robot. Otherwise the arm stays latched as it has started."""
        operations = (spec.moves for branch in self.branches.values() for spec in branch.operations.values())
        activities = (spec.moves for branch in self.branches.values() for spec in branch.activities.values())
        return ROBOT in self.branches or any(operations) or any(activities)

    @cached_property
    def revokers(self) -> frozenset[str]:
        """Branches whose change revokes a state of another: for example, a plan that changes while the robot moves."""
        return frozenset(self.revocations_by)
