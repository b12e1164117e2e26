"""The chart as PNG, Graphviz and Mermaid, and the command that writes it."""

from __future__ import annotations

import functools
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
import resvg_py
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart import dot, mermaid, png, svg
from pcmrs.authoring.chart.current import MAX_LEVEL
from pcmrs.authoring.chart.png import ZOOM
from pcmrs.cli.fsm.render import render
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec, ParentSpec
from tests.support.ratms_oracle import BLUEPRINT
from tests.support.trials import examples
from tests.unit.fsm import chart_reading as reading
from tests.unit.fsm.random_blueprints import blueprints

RATMS = str(BLUEPRINT)
GRAPHVIZ = shutil.which("dot")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"

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


@texts
@given(blueprints())
def test_mermaid_has_every_state_and_balanced_composites(blueprint: Blueprint) -> None:
    lines = [line.strip() for line in mermaid(blueprint).splitlines()]
    assert lines[0] == "stateDiagram-v2"
    assert sum(line.endswith("{") for line in lines) == lines.count("}") == len(blueprint.branches) + 1
    declared = [match.groups() for line in lines if (match := re.fullmatch(r'state ".*" as (\w+)_IS_(\w+)', line))]
    assert sorted(declared) == sorted(in_order(blueprint))
    assert lines.count("--") == len(blueprint.branches) - 1
    assert sum(line.startswith("[*] -->") for line in lines) == len(blueprint.branches)


@texts
@given(st.text())
def test_no_text_breaks_out_of_its_mermaid_line(text: str) -> None:
    plain = mermaid(Blueprint(id="x", version="1", title="t", branches={"b": BranchSpec(states={"a": "t"})}))
    odd = mermaid(Blueprint(id="x", version="1", title=text or "t", branches={"b": BranchSpec(states={"a": text})}))
    assert len(odd.splitlines()) == len(plain.splitlines())
    state = next(line for line in odd.splitlines() if line.endswith(" as b_IS_a"))
    assert state.count('"') == 2
    assert not re.search(r"[:;{}<>%]", re.sub(r"#\d+;", "", state))


@texts
@given(blueprints(), st.data())
def test_texts_highlight_just_the_given_states(blueprint: Blueprint, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), unique=True))
    current = {name: data.draw(st.sampled_from(list(blueprint.branches[name].states))) for name in chosen}
    assert set(re.findall(r"class (\w+)_IS_(\w+) current", mermaid(blueprint, current))) == set(current.items())
    assert set(re.findall(r'"(\w+)\.(\w+)" \[.*penwidth', dot(blueprint, current))) == set(current.items())


@pytest.mark.parametrize("draw", [svg, dot, mermaid])
def test_too_deep_nesting_is_refused(draw: Callable[[Blueprint], str]) -> None:
    levels = {f"b{level}": nested(level) for level in range(1, MAX_LEVEL + 2)}
    with pytest.raises(ConfigurationError, match="65 levels"):
        draw(Blueprint(id="x", version="1", branches=levels))
    del levels["b65"]
    assert "b64" in draw(Blueprint(id="x", version="1", branches=levels))


def nested(level: int) -> BranchSpec:
    parent = ParentSpec(branch=f"b{level - 1}", start="a", compatible={"a": ["a"]}) if level > 1 else None
    called = OperationSpec(from_=["*"], to="a", iio=True)
    emits = {"a": "called"} if parent else {}
    return BranchSpec(level=level, states={"a": ""}, parent=parent, emits=emits, operations={"called": called})


@pytest.fixture
def _font() -> None:
    """A picture's texts need a font of the system, which a bare one has not."""
    try:
        png(svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": ""})})))
    except ConfigurationError as error:
        pytest.skip(f"{error.text}")


@pytest.mark.usefixtures("_font")
def test_png_is_the_same_picture() -> None:
    drawn = svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": "where it starts"})}))
    picture = png(drawn)
    assert picture.startswith(PNG_SIGNATURE)
    root = reading.parse(drawn)
    assert struct.unpack(">II", picture[16:24]) == tuple(int(root.attrib[k]) * ZOOM for k in ("width", "height"))
    assert picture == png(drawn)


@pytest.mark.usefixtures("_font")
def test_png_shows_texts() -> None:
    drawn = svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": "where it starts"})}))
    assert png(drawn) != png(re.sub(r"<text.*?</text>", "", drawn, flags=re.DOTALL))


def test_a_system_without_fonts_gets_no_picture_without_names(monkeypatch: pytest.MonkeyPatch) -> None:
    without = functools.partial(resvg_py.svg_to_bytes, skip_system_fonts=True)
    monkeypatch.setattr(resvg_py, "svg_to_bytes", without)
    with pytest.raises(ConfigurationError, match="no font"):
        png(svg(Blueprint(id="x", version="1", branches={"b": BranchSpec(states={"a": ""})})))


def test_a_huge_png_is_refused_before_it_takes_memory() -> None:
    with pytest.raises(ConfigurationError, match="use svg"):
        png('<svg xmlns="http://www.w3.org/2000/svg" width="100000" height="100000"/>')


@pytest.mark.parametrize(("form", "begins"), [("svg", "<svg"), ("mermaid", "stateDiagram-v2"), ("dot", "digraph")])
def test_the_command_writes_each_text_to_standard_output(form: str, begins: str) -> None:
    done = CliRunner().invoke(render, [RATMS, "--format", form, "--state", "robot=1"])
    assert (done.exit_code, done.stderr) == (0, "")
    assert done.stdout.startswith(begins)


@pytest.mark.usefixtures("_font")
def test_the_command_writes_a_picture_to_a_file(tmp_path: Path) -> None:
    written = tmp_path / "chart.png"
    assert CliRunner().invoke(render, [RATMS, "--format", "png", "-o", str(written)]).exit_code == 0
    assert written.read_bytes().startswith(PNG_SIGNATURE)


@pytest.mark.parametrize("given_state", ["robot=7", "arm=1", "robot"])
def test_the_command_refuses_a_state_that_is_not_there(given_state: str) -> None:
    done = CliRunner().invoke(render, [RATMS, "--state", given_state])
    assert (done.exit_code, done.stdout) == (2, "")
    assert given_state.split("=")[0] in done.stderr


@pytest.mark.parametrize(
    ("raw", "status"),
    [(b"\xff", 2), (b"id = 1", 2), (b'id = "x"\nversion = "1"\nbranches.b.states = {}\n', 1)],
)
def test_the_command_says_why_it_cannot_draw(raw: bytes, status: int) -> None:
    done = CliRunner().invoke(render, ["-"], input=raw)
    assert (done.exit_code, done.stdout) == (status, "")
    assert "<stdin>:1" in done.stderr or "<stdin>:3" in done.stderr
