"""Random step tables, designed, and all endings in the workflows that they become."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import tomli_w
from hypothesis import strategies as st

from pcmrs.authoring.design import Design, design
from pcmrs.fsm import Blueprint, Closure, Engine, parse_blueprint

RANDOMS = st.randoms(use_true_random=False)
Joint = dict[str, str]


def designed(table: dict[str, Any]) -> tuple[Design, Blueprint]:
    result = design(tomli_w.dumps(table).encode())
    assert not result.findings, (table, [str(finding) for finding in result.findings])
    return result, parse_blueprint(result.text.encode())


def endings(engine: Engine) -> Iterator[tuple[Joint, str, str, dict[str, Joint] | None]]:
    """Every reachable joint state with every operation that may be asked for, and where that leads, if anywhere."""
    waiting = [engine.joint()]
    seen = {tuple(waiting[0].values())}
    while waiting:
        joint = waiting.pop()
        for branch, spec in engine.blueprint.branches.items():
            for operation in (name for name, each in spec.operations.items() if not each.iio):
                engine.place(joint)
                answer = engine.ask(branch, operation)
                if not isinstance(answer, Closure):
                    yield joint, branch, operation, None
                    continue
                after = {name: dict(change.states) for name, change in answer.outcomes.items()}
                yield joint, branch, operation, after
                new = {tuple(each.values()): each for each in after.values()}
                waiting += [each for key, each in new.items() if key not in seen]
                seen |= set(new)
