"""One state in a chart: its box holds its texts, and its ports leave room for their captions."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.chart._row import LABEL, LINE, MEANING, NAME, Port, row
from pcmrs.authoring.chart._text import mono_width, sans_width

LINES = st.lists(st.text("abc ", min_size=1, max_size=20), max_size=4)
PORTS = st.lists(LINES, max_size=6)


@given(left=PORTS, right=PORTS, loops=LINES, y=st.floats(-500, 500))
def test_ports_are_on_the_edge_with_room_for_their_captions(
    left: list[list[str]], right: list[list[str]], loops: list[str], y: float
) -> None:
    placed = row("standoff", "over the planned point", ["do / hold", "after 60 s / let_go"], loops)
    placed.left = [Port(number, caption) for number, caption in enumerate(left)]
    placed.right = [Port(number, caption) for number, caption in enumerate(right)]
    placed.place(y)
    assert placed.height > placed.text_height
    for ports in (placed.left, placed.right):
        above = placed.y
        for port in ports:
            assert port.y - above > LINE * len(port.caption)
            above = port.y
        assert above < placed.bottom


@given(st.text(max_size=80), st.text(max_size=200), st.lists(st.text(max_size=80), max_size=2), LINES)
def test_a_box_is_as_wide_as_each_of_its_texts(state: str, meaning: str, inner: list[str], loops: list[str]) -> None:
    made = row(state, meaning, inner, loops)
    assert made.width > mono_width(made.state, NAME)
    assert all(made.width > sans_width(line, MEANING) for line in made.meaning)
    assert all(made.width > mono_width(line, LABEL) for line in (*made.inner, *made.loops))


def test_a_port_without_caption_takes_less_room() -> None:
    bare, named = Port("line", []), Port("line", ["failed:", "approach"])
    assert 0 < bare.height < named.height
    assert (bare.width, named.width) == (0.0, mono_width("approach", LABEL))
