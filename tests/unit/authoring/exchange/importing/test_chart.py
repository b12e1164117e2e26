"""A state chart as all readers make it: who is inside whom, and which transitions an event may trigger."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.exchange.importing._chart import Edge, Node
from tests.unit.authoring.exchange.random_charts import Drawn, random_chart


def built(drawn: Drawn) -> Node:
    node = Node(drawn.id, (1, 1), parallel=drawn.kind == "parallel")
    for child in drawn.children:
        node.add(built(child))
    return node


@given(st.randoms(use_true_random=False))
def test_inside_and_outward_are_two_views_of_one_tree(rng: Random) -> None:
    drawn = random_chart(rng)
    root = built(drawn)
    assert [node.id for node in root.walk()] == [node.id for node in drawn.walk()]
    for node in root.walk():
        assert all(node in inner.outward() for inner in node.inside())
        assert node.inside() is not node.walk()
        assert node not in list(node.inside())
    for node in root.inside():
        assert list(node.outward())[-1] is root
        assert node.above is not None
        assert node in node.above.children
    assert root.by_id() == {node.id: node for node in root.walk() if node is not root}


def test_only_a_state_with_one_active_child_is_compound() -> None:
    root = Node("root", (1, 1))
    assert not root.compound
    both = root.add(Node("both", (2, 1), parallel=True))
    both.add(Node("one", (3, 1), name="first"))
    assert root.compound
    assert not both.compound
    assert [node.display_name for node in root.inside()] == ["both", "first"]


@pytest.mark.parametrize(
    ("event", "triggered"),
    [("door.open", ["door", "door.open"]), ("door.open.wide", ["door", "door.open"]), ("door", ["door"]), ("do", [])],
)
def test_an_event_triggers_what_names_a_beginning_of_it(event: str, triggered: list[str]) -> None:
    """Up to a dot, as in SCXML, and in the order of the file."""
    node = Node("a", (1, 1))
    node.edges = [Edge(node, [name, "other"], ["a"], (1, 1)) for name in ("door", "door.open", "door.shut", "doo")]
    assert [edge.events[0] for edge in node.edges_on(event)] == triggered
