"""Shapes of branches, operations, properties and stages: combinations of keys that contradict each other."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.finding import Finding


def check_shapes(blueprint: Blueprint) -> Iterator[Finding]:
    """Return contradictions within branches, operations, properties and stages; every name must exist."""
    for name, branch in blueprint.branches.items():
        yield from _level(blueprint, name, branch)
        for key, operation in branch.operations.items():
            path = ("branches", name, "operations", key)
            for text in _faults(blueprint, name, branch, operation):
                yield Finding(code="bad_operation", text=f"{name}.{key} {text}", path=path)
    yield from _latch(blueprint)
    yield from _stages(blueprint)
    identities: set[str] = set()
    for index, promise in enumerate(blueprint.properties):
        given = [promise.always, promise.never, promise.reachable, promise.leads_to]
        where = ("properties", str(index))
        if sum(condition is not None for condition in given) != 1:
            text = f"The property {promise.id} needs exactly one of always, never, reachable and leads_to."
            yield Finding(code="bad_property", text=text, path=where)
        if promise.id in identities:
            text = f"There are two properties {promise.id!r}: findings could not tell them apart."
            yield Finding(code="bad_property", text=text, path=where)
        identities.add(promise.id)


def _stages(blueprint: Blueprint) -> Iterator[Finding]:
    identities: set[str] = set()
    for index, stage in enumerate(blueprint.declared_stages):
        texts = [
            f"names {name}, which only a child branch calls." for name in stage.operations if _is_iio(blueprint, name)
        ]
        texts += [] if stage.goal else ["has no goal, so it is always reached: name the states in which it is."]
        texts += ["has the id of another: messages could not tell them apart."] if stage.id in identities else []
        for text in texts:
            yield Finding(code="bad_stage", text=f"The stage {stage.id} {text}", path=("stage", str(index)))
        identities.add(stage.id)


def _is_iio(blueprint: Blueprint, name: str) -> bool:
    branch, _, operation = name.partition(".")
    return blueprint.branches[branch].operations[operation].iio


def _latch(blueprint: Blueprint) -> Iterator[Finding]:
    """Return operations that Stop's latch would wrongly allow, or would bar permanently."""
    blocked: list[tuple[str, str]] = []
    for name, key, operation in _operations(blueprint):
        path = ("branches", name, "operations", key)
        if operation.blocked_when_latched:
            blocked.append((name, key))
        elif operation.moves or operation.affects_patient:
            what = "moves" if operation.moves else "affects the patient"
            text = f"{name}.{key} {what}, and would be allowed while Stop is latched: "
            text += "leave `blocked_when_latched` out."
            yield Finding(code="latch_ignored", text=text, path=(*path, "blocked_when_latched"))
    if blocked and not blueprint.unlatching:
        name, key = blocked[0]
        text = f"After a Stop, {name}.{key} could never be done again: mark an operation that users ask for, "
        text += "and that neither moves nor affects the patient, with unlatches = true."
        yield Finding(code="no_release", text=text, path=("branches", name, "operations", key))


def _operations(blueprint: Blueprint) -> Iterator[tuple[str, str, OperationSpec]]:
    for name, branch in blueprint.branches.items():
        yield from ((name, key, operation) for key, operation in branch.operations.items())


def _level(blueprint: Blueprint, name: str, branch: BranchSpec) -> Iterator[Finding]:
    parent, path = branch.parent, ("branches", name, "level")
    if parent is None and branch.level != 1:
        text = f"{name} is of level {branch.level} without a parent: only level 1 has none."
        yield Finding(code="bad_level", text=text, path=path)
    elif parent is None and branch.emits:
        text = f"{name} emits operations, but has no parent that they could call."
        yield Finding(code="bad_level", text=text, path=("branches", name, "emits"))
    elif parent is not None and branch.level != (above := blueprint.branches[parent.branch].level) + 1:
        text = f"{name} is of level {branch.level} under {parent.branch} of level {above}: it must be {above + 1}."
        yield Finding(code="bad_level", text=text, path=path)
    elif parent is not None and set(parent.compatible) != set(branch.states):
        missing = ", ".join(state for state in branch.states if state not in parent.compatible)
        text = f"`compatible` must name every state of {name}; missing: {missing}."
        yield Finding(code="bad_level", text=text, path=("branches", name, "parent", "compatible"))


def _faults(blueprint: Blueprint, branch: str, spec: BranchSpec, operation: OperationSpec) -> Iterator[str]:
    """Return the faults of an operation whose names all exist."""
    if (operation.to is None) == (not operation.outcomes):
        yield "needs either `to` or `outcomes`."
        return
    if not 0 < operation.timeout_s < math.inf:
        yield f"has timeout_s = {operation.timeout_s}: it must be above 0 and finite."
    if not operation.from_ or ("*" in operation.from_ and len(operation.from_) > 1):
        yield "needs states in `from`, or exactly ['*']."
    if operation.iio and (operation.steps or operation.checks or operation.outcomes or operation.requires):
        yield "is called by a child (iio): give it a target, but no checks, steps, outcomes or requires."
    if operation.iio and (operation.event or operation.rio or operation.blocked_when_latched or operation.unlatches):
        yield "is called by a child (iio): it cannot also be an event, motion, act, release or re-initiation."
    yield from _hazards(spec, operation)
    unconfirmed = operation.on_failure is not None or operation.on_unknown is not None
    if not operation.steps and (unconfirmed or operation.moves):
        yield "has no steps: it can neither move, nor fail, nor end in an unknown state."
    # After a failed motion the pose of the tool is not confirmed: an approach from there could hit the patient.
    for state in sorted(operation.unconfirmed_targets()) if operation.moves else ():
        starting = [key for key, o in spec.operations.items() if o.motion == "approach" and spec.valid_in(key, state)]
        if starting:
            yield f"may fail to {state}, where the approach {starting[0]} is valid: only a retreat may follow that."
    sources = {state for state in spec.states if state in operation.from_ or operation.from_ == ["*"]}
    for target in (*(e.to for e in operation.endings.values()), operation.on_failure, operation.on_unknown):
        if isinstance(target, dict) and set(target) != sources:
            yield f"has a target for each source state: the keys must be {sorted(sources)}, not {sorted(target)}."
    if isinstance(operation.refusal, dict) and not operation.refusal.keys() <= operation.requires.keys():
        yield f"has a refusal for {sorted(operation.refusal.keys() - operation.requires.keys())}, not in `requires`."
    for child in operation.sets:
        if child not in blueprint.children[branch]:
            yield f"sets {child}, which is not a child of {branch}."
    for revoked in {revoked: None for ending in operation.outcomes.values() for revoked in ending.diverted}:
        if revoked not in (other for other, _ in blueprint.revocations_by.get(branch, ())):
            yield f"has `revoked_to` without effect: no revocation of {revoked} names {branch} in `by`."


def _hazards(spec: BranchSpec, operation: OperationSpec) -> Iterator[str]:
    """Return the faults of an operation that moves, cannot be undone, or allows another that cannot."""
    undecided = operation.on_failure is None or operation.on_unknown is None
    if operation.event and (operation.moves or operation.affects_patient):
        yield "is an event: it can neither move nor affect the patient, since no user asks for it."
    if operation.moves and undecided:
        yield "moves: it needs `on_failure` and `on_unknown`, since it cannot end where it began."
    elif operation.irreversible and operation.steps and undecided:
        yield "is irreversible: it needs `on_failure` and `on_unknown`, since it may end halfway."
    if operation.irreversible and (operation.iio or operation.event or operation.rio):
        yield "is irreversible: it must be one that a user asks for, and not a re-initiation."
    if operation.allows_again and (operation.iio or operation.event or operation.rio or operation.irreversible):
        yield "has `allows_again`: it must be one that a user asks for, neither a re-initiation nor irreversible."
    if operation.confirm:
        yield "cannot be confirmed: users must ask for it, and no branch may be called <operation>_confirmation."
    for key in operation.allows_again:
        if not spec.operations[key].irreversible:
            yield f"allows {key} again, which is not irreversible: mark that, or leave it out."
