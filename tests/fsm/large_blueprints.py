"""Workflows with as many joint states as one likes."""

from __future__ import annotations

from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, ParentSpec, RevocationSpec


def free(branches: int, states: int) -> Blueprint:
    """Branches that know nothing of each other, each a ring of states: ``states ** branches`` joint states."""
    return Blueprint(id="free", version="1.0.0", branches={f"b{n}": _ring(states) for n in range(branches)})


def entangled(branches: int, states: int) -> Blueprint:
    """Rings in which every third refines the one before, every fifth is revoked and some require another."""
    made: dict[str, BranchSpec] = {}
    for n in range(branches):
        nested = n % 3 == 2
        made[f"b{n}"] = _ring(states, before=f"b{n - 1}" if n else None, nested=nested, revoked=n % 5 == 4)
    return Blueprint(id="entangled", version="1.0.0", branches=made, goal={"b0": ["s0"]})


def _ring(states: int, *, before: str | None = None, nested: bool = False, revoked: bool = False) -> BranchSpec:
    names = [f"s{n}" for n in range(states)]
    on = dict(zip(names, [*names[1:], names[0]], strict=True))
    requires = {} if before is None else {before: names[: states // 2 + 1]}
    operations = {
        "on": OperationSpec(from_=["*"], to=on, steps=["work"], on_failure=names[0]),
        "over": OperationSpec(from_=names[1:], to=names[0], requires=requires),
        "reinit": OperationSpec(from_=["*"], to=names[0], rio=True),
    }
    if before is None:
        parent = None
    else:
        parent = ParentSpec(branch=before, start=names[0], compatible=dict.fromkeys(names, names))
    return BranchSpec(
        level=2 if nested else 1,
        states=dict.fromkeys(names, "a state"),
        operations={**operations, "called": OperationSpec(from_=["*"], to={name: name for name in names}, iio=True)},
        parent=parent if nested else None,
        emits=dict.fromkeys(names, "called") if nested else {},
        revocations=[RevocationSpec(by=[before], from_=[names[-1]], to=names[0])] if revoked and before else [],
    )
