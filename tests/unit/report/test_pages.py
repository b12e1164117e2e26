"""Pages of reports: every text is escaped, a missing value is an error, and numbers are written alike."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import pytest
from jinja2 import UndefinedError

from pcmrs.report.pages import NONE, SVG, embedded, fixed, render, utc


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [(1.005, 1, "1.0"), (-0.126, 2, "−0.13"), (None, 2, NONE), (12.0, 0, "12"), (0.0, 3, "0.000")],
)
def test_numbers_have_so_many_decimals_and_a_true_minus(value: float | None, digits: int, shown: str) -> None:
    assert fixed(value, digits) == shown


def test_a_picture_is_in_the_page_itself() -> None:
    head, _, content = embedded(b"<svg/>\x00\xff", SVG).partition(",")
    assert head == "data:image/svg+xml;base64"
    assert base64.b64decode(content) == b"<svg/>\x00\xff"


@pytest.mark.parametrize(("wall", "shown"), [(0.0, "1970-01-01 00:00"), (1.8e9, "2027-01-15 08:00")])
def test_times_are_utc_wherever_the_machine_is(wall: float, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Asia/Tokyo")
    assert utc(wall, "%Y-%m-%d %H:%M") == shown


def loud(text: str) -> str:
    return text.upper()


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A package with a template, under a name that no other test uses."""
    folder = tmp_path / "pages_of_a_test"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "page.j2").write_text("<p>{{ text|loud }}</p>{% if more %}{{ more.missing }}{% endif %}")
    monkeypatch.syspath_prepend(str(tmp_path))
    return folder.name


def test_markup_in_a_value_is_text(package: str) -> None:
    assert render(package, "page.j2", loud, text="<b>&", more=None) == "<p>&lt;B&gt;&amp;</p>"


@pytest.mark.parametrize("values", [{"more": None}, {"text": "a"}, {"text": "a", "more": {"other": 1}}])
def test_a_value_that_is_not_given_is_an_error(package: str, values: dict[str, Any]) -> None:
    """An empty place in a report would be read as nothing to report."""
    with pytest.raises(UndefinedError):
        render(package, "page.j2", loud, **values)
