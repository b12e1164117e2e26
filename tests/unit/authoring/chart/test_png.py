"""The state chart as a PNG picture."""

from __future__ import annotations

import functools
import re
import struct

import pytest
import resvg_py

from pcmrs.authoring.chart import png, svg
from pcmrs.authoring.chart._png import ZOOM
from pcmrs.errors import ConfigurationError
from pcmrs.fsm.blueprint import Blueprint, BranchSpec
from tests.unit.authoring.chart import chart_reading as reading
from tests.unit.authoring.chart.fonts import skip_without_font

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def _font() -> None:
    skip_without_font()


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
