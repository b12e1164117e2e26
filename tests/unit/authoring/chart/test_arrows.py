"""Arrows inside a branch: each ending of an operation is at one, from where the operation is valid."""

from __future__ import annotations

from hypothesis import given

from pcmrs.authoring.chart import svg
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from tests.support.trials import examples
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints


def in_every_state(operation: OperationSpec, branch: BranchSpec) -> list[str]:
    return list(branch.states) if operation.from_ == ["*"] else operation.from_


@examples(25)
@given(blueprints())
def test_every_ending_is_at_an_arrow_from_where_it_may_start(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    arrows = [(group.attrib, reading.texts(group)) for group in reading.groups(root, "arrow")]
    loops = {(g.attrib["data-branch"], g.attrib["data-state"]): reading.texts(g) for g in reading.groups(root, "state")}
    for name, branch in blueprint.branches.items():
        for called, operation in branch.operations.items():
            for outcome, ending in operation.endings.items():
                if operation.iio or ending.requires.get(name):
                    continue
                label = f"{called}: {outcome}" if operation.outcomes else called
                for source in in_every_state(operation, branch):
                    target = ending.to if isinstance(ending.to, str) else ending.to[source]
                    drawn = [
                        text
                        for given, text in arrows
                        if (given["data-branch"], given["data-target"]) == (name, target)
                        and ({source, "*"} & set(given["data-sources"].split()))
                        and "transition" in given["class"]
                    ]
                    kept = loops[name, target] if source == target else ""
                    assert any(label in text for text in (*drawn, kept))
