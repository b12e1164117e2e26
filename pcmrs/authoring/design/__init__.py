"""From an expert's table of steps to a verified blueprint."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from pcmrs.authoring.design._branches import DesignedBranch, root_branches
from pcmrs.authoring.design._check import Ask, check_table, fill_in, paths_of
from pcmrs.authoring.design._count import Combinations, Impossible, count_combinations, excess_of
from pcmrs.authoring.design._grouping import StepGroup, UndesignableError, root_groups
from pcmrs.authoring.design._hazards import GuardedOrder, hazards_in
from pcmrs.authoring.design._requirements import properties_of
from pcmrs.authoring.design._safety import ROBOT, SAFETY, robot_branch, safety_branch
from pcmrs.authoring.design.tables import StepTable
from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint, Requirement
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.files.load import examine
from pcmrs.fsm.files.places import Places, with_locations
from pcmrs.fsm.files.toml import convert, read_toml
from pcmrs.fsm.finding import Finding, Path
from pcmrs.fsm.verify import MAX_JOINT_STATES

__all__ = [
    "Ask",
    "Combinations",
    "Design",
    "Impossible",
    "design",
    "paths_of",
]

HEAD = "Designed from a step table by `pcmrs fsm design`: change the table, not this file."


@dataclass(frozen=True, slots=True)
class Design:
    """Result of designing a workflow from a step table.

    Attributes:
        text: The blueprint's file; empty if there are findings.
        combinations: Combinations of the level 1 steps; None if the table has faults.
        findings: All faults, with their places in the step table; empty for a sound blueprint.
        readable: The file is a step table.
    """

    text: str = ""
    combinations: Combinations | None = None
    findings: list[Finding] = field(default_factory=list)
    readable: bool = True


def design(
    raw: bytes,
    *,
    origin: str = "steps",
    progress: Callable[[int, int], None] | None = None,
    ask: Ask | None = None,
) -> Design:
    """Design the blueprint of a step table and verify it.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        ask: Called for each operation whose effect on the patient the table does not declare: gets the operation and
            returns the keys that are true. Without it such a table is refused.
        progress: See `pcmrs.fsm.verify.verify`.
    """
    try:
        content, places = read_toml(raw, origin)
        table = convert(content, StepTable, places)
        if ask is not None:
            fill_in(content, table, ask)
            table = convert(content, StepTable, places)
    except BlueprintError as error:
        return Design(findings=error.fields["findings"], readable=False)
    faults = list(check_table(table))
    if faults:
        return Design(findings=with_locations(faults, places))
    try:
        return _design(table, places, progress)
    except UndesignableError as error:
        return Design(findings=with_locations([error.finding], places))


def _design(table: StepTable, places: Places, progress: Callable[[int, int], None] | None) -> Design:
    paths = {step.name: path for path, step in paths_of(table.steps)}
    groups = root_groups(table.steps, paths)
    combinations = count_combinations([group.order for group in groups])
    _check_count(combinations)
    branches = [branch for group in groups for branch in root_branches(group, paths)]
    branches += _safety_branches(table, groups)
    _check_names(branches)
    text = blueprint_toml(_blueprint(table, groups, branches), comment=HEAD)
    examination = examine(text.encode(), origin="blueprint", progress=progress)
    excess = excess_of(examination, len(text.encode()), branches)
    placed = [excess] if excess else _at_their_steps(examination.findings, branches, len(table.requirements))
    findings = with_locations(placed, places)
    return Design("" if findings else text, combinations, findings)


def _check_count(combinations: Combinations) -> None:
    if combinations.possible > MAX_JOINT_STATES:
        text = (
            f"The steps allow {combinations.possible} combinations, the limit is {MAX_JOINT_STATES}: "
            "declare more dependencies, or refine some steps."
        )
        raise UndesignableError(Finding(code="step_count", text=text, path=("steps",)))


def _check_names(branches: Iterable[DesignedBranch]) -> None:
    seen: set[str] = set()
    for branch in branches:
        if branch.name in seen:
            text = f"There would be two branches {branch.name!r}: give steps that are not connected different branches."
            raise UndesignableError(Finding(code="name_collision", text=text, path=branch.path))
        seen.add(branch.name)


def _blueprint(table: StepTable, groups: Sequence[StepGroup], branches: Sequence[DesignedBranch]) -> Blueprint:
    return Blueprint(
        id=table.id,
        version=table.version,
        title=table.title,
        goal={group.name: [group.order.state(group.order.all)] for group in groups},
        branches={branch.name: branch.spec for branch in branches},
        properties=list(properties_of(table.requirements, branches)),
        provenance=table.provenance,
    )


def _safety_branches(table: StepTable, groups: Iterable[StepGroup]) -> Iterator[DesignedBranch]:
    """Return the branches for the connection of the robot and for the release of Stop, if they are needed."""
    hazards = list(hazards_in(step for _, step in paths_of(table.steps)))
    if any(hazard.moves for hazard in hazards):
        orders = {group.name: group.order for group in groups}
        safe: Requirement = {
            name: [order.state(each) for each in order.combinations if not order.unsafe(each)]
            for name, order in orders.items()
            if isinstance(order, GuardedOrder) and order.moving
        }
        yield DesignedBranch(ROBOT, robot_branch(safe), ("steps",))
    if any(hazard.counts or hazard.confirm for hazard in hazards):
        yield DesignedBranch(SAFETY, safety_branch(), ("steps",))


def _at_their_steps(
    findings: Iterable[Finding], branches: Iterable[DesignedBranch], requirements: int
) -> list[Finding]:
    """Return the findings of the blueprint, each at the step or requirement that causes it."""
    origins: dict[Path, Path] = {("properties", str(i)): ("requirements", str(i)) for i in range(requirements)}
    for branch in branches:
        path = ("branches", branch.name)
        origins[path] = branch.path
        origins |= {(*path, "operations", command.name): command.path for command in branch.commands}
    return [msgspec.structs.replace(finding, path=_origin(finding.path, origins)) for finding in findings]


def _origin(path: Path, origins: Mapping[Path, Path]) -> Path:
    """Return the path in the table; `id`, `version` and `title` have the same path in both."""
    while len(path) > 1 and path not in origins:
        path = path[:-1]
    return origins.get(path, path)
