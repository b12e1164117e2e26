"""Workflows with as many joint states as one likes."""

from __future__ import annotations

import msgspec

from pcmrs.fsm.blueprint import (
    Blueprint,
    BranchSpec,
    Condition,
    OperationSpec,
    ParentSpec,
    PropertySpec,
    RevocationSpec,
)


def free(branches: int, states: int) -> Blueprint:
    """Branches that know nothing of each other, each a ring of states: ``states ** branches`` joint states."""
    return Blueprint(id="free", version="1.0.0", branches={f"b{n}": _ring(states) for n in range(branches)})


def entangled(branches: int, states: int) -> Blueprint:
    """Rings in which every third refines the one before, every fifth is revoked and all require another."""
    made = {f"b{n}": _ring(states, before=f"b{n - 1}" if n else None) for n in range(branches)}
    names = [f"s{n}" for n in range(states)]
    for n in range(2, branches, 3):
        made[f"b{n}"] = _nested(made[f"b{n}"], f"b{n - 1}", names)
        made[f"b{n - 1}"] = _called(made[f"b{n - 1}"], names)
    for n in range(4, branches, 5):
        rule = RevocationSpec(by=[f"b{n - 1}"], from_=[names[-1]], to=names[0])
        made[f"b{n}"] = msgspec.structs.replace(made[f"b{n}"], revocations=[rule])
    return Blueprint(id="entangled", version="1.0.0", branches=made, goal={"b0": ["s0"]})


def promising(branches: int) -> Blueprint:
    """Free rings of two states, with a goal and a promise on what runs, which doubles what must be looked at."""
    alone = PropertySpec(
        id="alone",
        when=Condition(running=["b0.on"]),
        leads_to=Condition(states={"b0": ["s1"], f"b{branches - 1}": ["s1"]}),
    )
    return msgspec.structs.replace(free(branches, 2), properties=[alone], goal={"b0": ["s1"]})


def _ring(states: int, *, before: str | None = None) -> BranchSpec:
    names = [f"s{n}" for n in range(states)]
    on = dict(zip(names, [*names[1:], names[0]], strict=True))
    requires = {} if before is None else {before: names[: states // 2 + 1]}
    operations = {
        "on": OperationSpec(from_=["*"], to=on, steps=["work"], on_failure=names[0]),
        "over": OperationSpec(from_=names[1:], to=names[0], requires=requires),
        "reinit": OperationSpec(from_=["*"], to=names[0], rio=True),
    }
    return BranchSpec(states=dict.fromkeys(names, "a state"), operations=operations)


def _nested(branch: BranchSpec, above: str, names: list[str]) -> BranchSpec:
    parent = ParentSpec(branch=above, start=names[0], compatible=dict.fromkeys(names, names))
    return msgspec.structs.replace(branch, level=2, parent=parent, emits=dict.fromkeys(names, "called"))


def _called(branch: BranchSpec, names: list[str]) -> BranchSpec:
    called = OperationSpec(from_=["*"], to={name: name for name in names}, iio=True)
    return msgspec.structs.replace(branch, operations={**branch.operations, "called": called})
