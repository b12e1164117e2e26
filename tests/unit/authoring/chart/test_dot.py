"""The state chart as Graphviz text."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import dot
from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

GRAPHVIZ = shutil.which("dot")

texts = examples(25)


def in_order(blueprint: Blueprint) -> list[tuple[str, str]]:
    return [(name, state) for name, branch in blueprint.branches.items() for state in branch.states]


@texts
@given(blueprints())
def test_graphviz_has_every_state_in_the_cluster_of_its_branch(blueprint: Blueprint) -> None:
    """Clusters are nested as the branches are."""
    open_clusters: list[str] = []
    found: dict[tuple[str, str], list[str]] = {}
    for line in dot(blueprint).splitlines():
        if cluster := re.match(r' *subgraph "cluster_(\w+)" {', line):
            open_clusters.append(cluster[1])
        elif line.strip() == "}" and open_clusters:
            open_clusters.pop()
        elif node := re.match(r' *"(\w+)\.(\w+)" \[', line):
            found[node[1], node[2]] = list(open_clusters)
    assert set(found) == set(in_order(blueprint))
    for (name, _), clusters in found.items():
        parent = blueprint.branches[name].parent
        assert clusters[-1] == name
        assert clusters[-2:-1] == ([parent.branch] if parent else [])


@pytest.mark.skipif(GRAPHVIZ is None, reason="Graphviz is not installed")
@examples(5)
@given(blueprints(), st.text(), st.text())
def test_graphviz_accepts_any_chart(blueprint: Blueprint, title: str, meaning: str) -> None:
    odd = BranchSpec(title=title, states={"a": meaning, "b": title})
    chart = dot(Blueprint(id="x", version="1", title=title, branches={**blueprint.branches, "odd": odd}))
    done = subprocess.run([str(GRAPHVIZ), "-Tcanon"], input=chart.encode(), capture_output=True, check=False)
    assert done.returncode == 0
    assert b"Error" not in done.stderr
