"""What is wrong with a step table: names, dependencies, refinements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from graphlib import CycleError, TopologicalSorter

from pcmrs.fsm.design.table import StepSpec, StepTable
from pcmrs.fsm.finding import Finding, Path

MAX_STEPS = 256
MAX_STEPS_OF_A_BRANCH = 32
"""A state's name has one digit for each step and at most 32 characters."""


def paths_of(steps: Sequence[StepSpec], above: Path = ()) -> Iterator[tuple[Path, StepSpec]]:
    """All steps, those of refinements too, and where in the table they are."""
    for i, step in enumerate(steps):
        path = (*above, "steps", str(i))
        yield path, step
        if step.refined_by is not None:
            yield from paths_of(step.refined_by.steps, (*path, "refined_by"))


def check_table(table: StepTable) -> Iterator[Finding]:
    """All that can be said before the steps are grouped into branches."""
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


def _doubled(found: Sequence[tuple[Path, StepSpec]]) -> Iterator[Finding]:
    seen: set[str] = set()
    for path, step in found:
        if step.name in seen:
            text = f"The step {step.name!r} is there twice: every step, refining ones too, needs its own name."
            yield Finding(code="step_name", text=text, path=(*path, "name"))
        seen.add(step.name)


def _dependencies(steps: Sequence[StepSpec], above: Path) -> Iterator[Finding]:
    """Checks the dependencies of the steps of one level, then of the levels below."""
    needs = {step.name: set(step.depends_on) for step in steps}
    for i, step in enumerate(steps):
        for j, name in enumerate(step.depends_on):
            if name not in needs:
                text = f"{step.name} depends on {name!r}, which is no step beside it: {', '.join(needs)} are."
                yield Finding(code="step_unknown", text=text, path=(*above, "steps", str(i), "depends_on", str(j)))
    try:
        TopologicalSorter(needs).prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        where = next(i for i, step in enumerate(steps) if step.name == cycle[0])
        text = f"These steps wait for each other: {' needs '.join(cycle)}. Leave one dependency out."
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
        text = f"{step.name} does not say how a point is performed: name at least one of its `steps`."
        yield Finding(code="step_refinement", text=text, path=where)
    own = step.checks or step.steps or step.payload != "none"
    if refinement.steps and own:
        text = f"{step.name} is achieved by the steps that refine it: put payload, checks and steps there."
        yield Finding(code="step_refinement", text=text, path=path)
    for i, each in enumerate(refinement.steps):
        if each.branch:
            text = f"{each.name} belongs to {refinement.branch}, which refines {step.name}: leave `branch` out."
            yield Finding(code="step_branch", text=text, path=(*where, "steps", str(i), "branch"))
