"""The picture of a demo in the README: its means are those of its rows, as good as promised, beside the paper's."""

from __future__ import annotations

import html
import re
from collections import defaultdict
from statistics import mean, stdev

import pytest

from pcmrs_lab.experiment.published import PUBLISHED
from tests import ROOT
from tests.unit.lab.experiment.test_experiments import ROTATION_DEG, TRANSLATION_MM

PICTURE = ROOT / "docs" / "pictures" / "demo.svg"


def lines() -> list[list[str]]:
    """The texts of each line of the picture, from top to bottom."""
    found: dict[float, list[str]] = defaultdict(list)
    for y, text in re.findall(r'<text[^>]*? y="([\d.]+)"[^>]*>(.*?)</text>', PICTURE.read_text()):
        found[float(y)].append(html.unescape(text).replace("\xa0", " ").strip())
    return [[text for text in found[y] if text] for y in sorted(found)]


def numbers(words: str) -> list[float]:
    """All numbers in the line that begins with these words, from left to right."""
    (line,) = [line for line in lines() if line and line[0].startswith(words)]
    return [float(number) for text in line[1:] for number in re.findall(r"-?\d+\.\d+", text)]


def placements() -> list[list[float]]:
    """What stands in the rows of the trials, beginning with their number."""
    rows = [line for line in lines() if line and re.fullmatch(r"\d+", line[0])]
    return [[float(number) for text in row for number in text.split()] for row in rows]


def test_the_means_are_those_of_the_twelve_rows() -> None:
    trials = placements()
    assert [trial[0] for trial in trials] == list(range(1, 13))
    columns = list(zip(*trials, strict=True))
    for words, column in (("measured by", 7), ("true:", 9)):
        millimetres, degrees = columns[column], columns[column + 1]
        shown = numbers(words)
        expected = [mean(millimetres), stdev(millimetres), mean(degrees), stdev(degrees)]
        assert shown == pytest.approx(expected, abs=1.5e-4), words


def test_errors_are_as_promised_and_shown_beside_the_paper() -> None:
    millimetres, _, degrees, _ = numbers("measured by")
    assert millimetres <= TRANSLATION_MM
    assert degrees <= ROTATION_DEG
    published = PUBLISHED["ratms"]
    assert numbers("paper") == [published.translation_error_mm.mean, published.rotation_error_deg.mean]
