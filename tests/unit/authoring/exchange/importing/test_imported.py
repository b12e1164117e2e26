"""Charts that are read are checked before they are converted, and their blueprints are written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pcmrs.authoring.exchange.importing._chart import Edge, Node
from pcmrs.authoring.exchange.importing._reading import Findings
from pcmrs.authoring.exchange.importing.imported import blueprint_file, import_chart
from pcmrs.errors import BlueprintError
from pcmrs.fsm import parse_blueprint
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import refuse


def door(spoil: Callable[[Node, Node, Node], None] = lambda *_: None) -> Node:
    """A chart of two states with an arrow there and back."""
    root = Node("", (1, 1), name="door")
    shut, ajar = root.add(Node("shut", (2, 1))), root.add(Node("ajar", (3, 1)))
    shut.edges = [Edge(shut, ["open"], ["ajar"], (4, 5))]
    ajar.edges = [Edge(ajar, ["close"], ["shut"], (5, 5))]
    spoil(root, shut, ajar)
    return root


def test_a_sound_chart_becomes_a_workflow_that_is_read_back() -> None:
    blueprint, findings = import_chart(b"", "door.mmd", lambda *_: door())
    assert blueprint is not None, findings
    text, unsound = blueprint_file(blueprint, "folder/door.mmd", "door.toml")
    assert (findings, unsound) == ([], [])
    assert text.startswith("# Imported from door.mmd.\n")
    assert parse_blueprint(text.encode()).branches == blueprint.branches


def set_initial(root: Node, shut: Node, ajar: Node) -> None:
    inner = ajar.add(Node("inner", (6, 1)))
    root.initial = inner.id


def go_two_ways(root: Node, shut: Node, ajar: Node) -> None:
    shut.edges[0].targets = ["ajar", "shut"]


def need_nowhere(root: Node, shut: Node, ajar: Node) -> None:
    shut.edges[0].condition = (("shut", "nowhere"),)


@pytest.mark.parametrize(
    ("spoil", "code", "line", "words"),
    [
        (lambda root, shut, _: root.add(Node("shut", (9, 1))), "name_collision", 2, "two states 'shut'"),
        (lambda root, *_: root.children.clear(), "no_states", 1, "no state"),
        (set_initial, "not_supported", 1, "'inner' is not directly inside door"),
        (lambda root, shut, _: shut.edges[0].targets.append("nowhere"), "unknown_state", 4, "'nowhere' to go to"),
        (need_nowhere, "unknown_state", 4, "'nowhere' to be in"),
        (go_two_ways, "not_supported", 4, "ajar and shut can never be active together"),
    ],
)
def test_a_chart_that_contradicts_itself_is_not_converted(
    spoil: Callable[[Node, Node, Node], None], code: str, line: int, words: str
) -> None:
    blueprint, findings = import_chart(b"", "door.mmd", lambda *_: door(spoil))
    assert blueprint is None
    assert [(each.code, each.file, each.line) for each in findings] == [(code, "door.mmd", line)]
    assert words in findings[0].text


def test_findings_of_a_reader_are_those_of_the_import() -> None:
    def complain(_raw: bytes, findings: Findings) -> Node:
        findings.add("not_supported", "A fork is not supported.", (7, 2))
        return door()

    def give_up(_raw: bytes, findings: Findings) -> Node:
        findings.add("not_supported", "A fork is not supported.", (7, 2))
        refuse(findings.origin, "too_deep", "Too deep.", (8, 1))

    for read, code in ((complain, "not_supported"), (give_up, "too_deep")):
        blueprint, findings = import_chart(b"", "door.mmd", read)
        assert (blueprint, [each.code for each in findings]) == (None, [code])
    with pytest.raises(BlueprintError):
        give_up(b"", Findings("door.mmd"))


def test_a_blueprint_too_large_to_be_read_is_no_text() -> None:
    go = OperationSpec(from_=["a"], to="a", title="x" * MAX_BYTES)
    large = Blueprint(id="x", version="1", branches={"x": BranchSpec(states={"a": ""}, operations={"go": go})})
    text, (finding,) = blueprint_file(large, "x.scxml", "x.toml")
    assert (text, finding.code, finding.file) == ("", "too_large", "x.scxml")
    assert f"the limit is {MAX_BYTES}" in finding.text
