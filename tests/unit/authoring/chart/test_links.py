"""Links between branches: Rules 2 and 3, and revocations."""

from __future__ import annotations

from hypothesis import given

from pcmrs.authoring.chart import svg
from pcmrs.fsm.blueprint import Blueprint
from tests.support.trials import examples
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints


@examples(25)
@given(blueprints())
def test_rules_and_revocations_join_branches(blueprint: Blueprint) -> None:
    root = reading.parse(svg(blueprint))
    found = {kind: reading.groups(root, kind) for kind in ("signal", "call", "revocation")}
    links = {kind: [group for group in found[kind] if "link" in group.attrib["class"]] for kind in found}
    nested = {name: branch for name, branch in blueprint.branches.items() if branch.parent is not None}
    signals = [(group.attrib["data-tails"].split(", "), reading.texts(group).split()) for group in links["signal"]]
    said = {(tail, words[0]) for tails, words in signals for tail in tails}
    assert said == {(f"{name} {state}", called) for name in nested for state, called in nested[name].emits.items()}
    assert len(links["call"]) == len(nested)
    revoked = {group.attrib["data-heads"] for group in links["revocation"]}
    assert revoked == {name for name, branch in blueprint.branches.items() if branch.revocations}
