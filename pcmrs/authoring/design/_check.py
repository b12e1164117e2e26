"""Checks of a step table: names, dependencies, refinements; and questions about what it leaves open."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from graphlib import CycleError, TopologicalSorter
from typing import Any

from pcmrs.authoring.design._hazards import hazard_of, ways_of
from pcmrs.authoring.design.tables import DECLARATIONS, ActionSpec, StepSpec, StepTable
from pcmrs.fsm.finding import Finding, Path, hint

MAX_STEPS = 256
TOP = 2
"""Number of keys in the path of a step of the first level."""

MAX_STEPS_OF_A_BRANCH = 32
"""A state's name has one digit for each step and at most 32 characters."""


def paths_of(steps: Sequence[StepSpec], above: Path = ()) -> Iterator[tuple[Path, StepSpec]]:
    """Return all steps, those of refinements too, with their paths in the table.

    Args:
        steps: Steps of one level.
        above: Path of the step that they refine.
    """
    for i, step in enumerate(steps):
        path = (*above, "steps", str(i))
        yield path, step
        if step.refined_by is not None:
            yield from paths_of(step.refined_by.steps, (*path, "refined_by"))


def check_table(table: StepTable) -> Iterator[Finding]:
    """Return the findings that do not depend on the grouping of steps into branches."""
    for i, each in enumerate(table.unresolved):
        text = f"The draft has an open finding: {each} Correct the table, then remove this line from `unresolved`."
        yield Finding(code="draft_unresolved", text=text, path=("unresolved", str(i)))
    found = list(paths_of(table.steps))
    if not 1 <= len(found) <= MAX_STEPS:
        text = f"The table has {len(found)} steps; it must have 1 to {MAX_STEPS}."
        yield Finding(code="step_count", text=text, path=("steps",))
        return
    yield from _doubled(found)
    yield from _dependencies(table.steps, ())
    for path, step in found:
        if step.refined_by is not None:
            yield from _refinement(path, step)
        yield from _hazards(path, step, refines=len(path) > TOP)
    yield from _nested(table.steps)
    yield from (_undeclared(path, name) for path, name, _ in undeclared(table))


def undeclared(table: StepTable) -> Iterator[tuple[Path, str, ActionSpec]]:
    """Return the actions that do not declare their effect on the patient: path in the table, operation, action.

    A refined step does nothing itself; an alternative inherits from its step; an operation that takes a step back
    without `steps` is a mere report.
    """
    for path, step in paths_of(table.steps):
        if not (step.declared or (step.refined_by is not None and step.refined_by.points is None)):
            yield path, step.operation, step
        for j, reopener in enumerate(step.reopened_by):
            if isinstance(reopener, ActionSpec) and reopener.steps and not reopener.declared:
                yield (*path, "reopened_by", str(j)), reopener.operation, reopener


def _doubled(found: Sequence[tuple[Path, StepSpec]]) -> Iterator[Finding]:
    seen: set[str] = set()
    for path, step in found:
        if step.name in seen:
            text = f"There are two steps {step.name!r}: every step, also in a refinement, needs its own name."
            yield Finding(code="step_name", text=text, path=(*path, "name"))
        seen.add(step.name)


def _dependencies(steps: Sequence[StepSpec], above: Path) -> Iterator[Finding]:
    """Check the dependencies of the steps of one level, then of the levels below."""
    needs = {step.name: set(step.depends_on) for step in steps}
    for i, step in enumerate(steps):
        for j, name in enumerate(step.depends_on):
            if name not in needs:
                text = f"{step.name} depends on the unknown step {name!r}; {hint(name, needs)}"
                yield Finding(code="step_unknown", text=text, path=(*above, "steps", str(i), "depends_on", str(j)))
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        where = next(i for i, step in enumerate(steps) if step.name == cycle[0])
        text = f"These steps depend on each other in a circle: {' needs '.join(cycle)}. Leave one dependency out."
        yield Finding(code="step_cycle", text=text, path=(*above, "steps", str(where), "depends_on"))
    for i, step in enumerate(steps):
        if step.refined_by is not None:
            yield from _dependencies(step.refined_by.steps, (*above, "steps", str(i), "refined_by"))


def _refinement(path: Path, step: StepSpec) -> Iterator[Finding]:
    refinement, where = step.refined_by, (*path, "refined_by")
    if refinement is None:
        return
    if bool(refinement.steps) == (refinement.points is not None):
        text = f"{step.name} is refined either by `steps` or by `points`."
        yield Finding(code="step_refinement", text=text, path=where)
    if step.alternatives:
        text = f"{step.name} is achieved by its refinement alone: put the alternatives there."
        yield Finding(code="step_refinement", text=text, path=(*path, "alternatives"))
    if refinement.points is not None and not step.steps:
        text = f"{step.name} does not define how a point is performed: give at least one of its `steps`."
        yield Finding(code="step_refinement", text=text, path=where)
    own = step.checks or step.steps or step.payload != "none"
    if refinement.steps and own:
        text = f"{step.name} is achieved by the steps that refine it: put payload, checks and steps there."
        yield Finding(code="step_refinement", text=text, path=path)
    for i, each in enumerate(refinement.steps):
        if each.branch:
            text = f"{each.name} belongs to {refinement.branch}, which refines {step.name}: leave `branch` out."
            yield Finding(code="step_branch", text=text, path=(*where, "steps", str(i), "branch"))


def _undeclared(path: Path, name: str) -> Finding:
    text = f"{name} does not declare its effect on the patient. Add what is true, as in `moves = true`: `moves` "
    text += "(the robot), `affects_patient`, `irreversible`, `confirm` (asks for a confirmation each time); "
    text += "or `moves = false` if none is."
    return Finding(code="step_undeclared", text=text, path=path)


def _hazards(path: Path, step: StepSpec, *, refines: bool) -> Iterator[Finding]:
    """Return declarations in places where they cannot be tracked."""
    own = hazard_of(step)
    ways = [own, *(hazard_of(other, step) for other in step.alternatives)]
    by_steps = step.refined_by is not None and step.refined_by.points is None
    if by_steps and (own.counts or own.confirm):
        text = f"{step.name} is achieved by the steps that refine it: it moves and affects nothing itself."
        yield Finding(code="step_hazard", text=text, path=path)
    if refines and any(each.counts for each in (*ways, *map(hazard_of, step.reopeners()))):
        text = (
            f"{step.name} refines another step, and reaches the patient or cannot be undone: put it on the first level."
        )
        yield Finding(code="step_hazard", text=text, path=path)
    if step.refined_by is not None and own.irreversible:
        text = f"{step.name} is irreversible and is done by points: make each of them a step."
        yield Finding(code="step_hazard", text=text, path=path)
    for j, other in enumerate(step.alternatives):
        if other.partial and hazard_of(other, step).irreversible:
            text = f"{other.operation} cannot be undone, but takes several attempts: each of them would be repeated."
            yield Finding(code="step_hazard", text=text, path=(*path, "alternatives", str(j)))
    for j, reopener in enumerate(step.reopeners()):
        if hazard_of(reopener).irreversible:
            text = f"{reopener.operation} takes {step.name} back, so it cannot be irreversible itself: leave that out."
            yield Finding(code="step_hazard", text=text, path=(*path, "reopened_by", str(j)))


def _nested(steps: Sequence[StepSpec]) -> Iterator[Finding]:
    """Return refinements of several levels that would be left behind when the step they depend on is made safe."""
    reaching = {step.name for step in steps if any(hazard.counts for _, hazard in ways_of(step))}
    for _ in steps:
        reaching |= {step.name for step in steps if reaching & set(step.depends_on)}
    for i, step in enumerate(steps):
        below = step.refined_by.steps if step.refined_by is not None else []
        if step.name in reaching and any(each.refined_by is not None for each in below):
            text = f"{step.name} depends on a step that reaches the patient, and is refined by several levels: use one."
            yield Finding(code="step_hazard", text=text, path=("steps", str(i), "refined_by"))


Ask = Callable[[str], Collection[str]]
"""Takes the name of an operation and returns those of `DECLARATIONS` that are true of it."""


def fill_in(content: dict[str, Any], table: StepTable, ask: Ask) -> None:
    """Write the answers into the content of a table.

    Args:
        content: Content of the file; changed in place.
        table: The table, converted.
        ask: Called once for each action without a declaration.
    """
    for path, operation, _ in undeclared(table):
        true = ask(operation)
        place: Any = content
        for key in path:
            place = place[int(key)] if isinstance(place, list) else place[key]
        place |= {key: key in true for key in DECLARATIONS}
