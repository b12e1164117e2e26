"""The picture of a registration shows its residuals in mm, beside the limit of their mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pcmrs.cli.register_plot import ENLARGED, draw
from pcmrs.formats.landmarks import Pairs
from pcmrs.spatial import Transform

PLANNED = np.array([(0.0, 0.08, 0.0), (0.07, 0.0, 0.0), (-0.07, 0.0, 0.0), (0.0, 0.0, 0.09)])
ERRORS = np.array([(0.001, 0.0, 0.0), (0.0, -0.002, 0.0), (0.0, 0.0, 0.003), (0.0, 0.0, 0.0)])
BODY_REF_FROM_IMAGE = Transform.from_rotvec((0.1, -0.2, 0.05), (0.3, 2.0, -0.7))
PAIRS = Pairs(("nasion", "left", "right", "top"), PLANNED, BODY_REF_FROM_IMAGE @ (PLANNED + ERRORS), "name")


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Figure:
    """The figure that is saved."""
    figures: list[Figure] = []

    def keep(figure: Figure, *_: Any, **__: Any) -> None:
        figures.append(figure)

    monkeypatch.setattr(Figure, "savefig", keep)
    draw(PAIRS, BODY_REF_FROM_IMAGE, 0.004, "accepted " + "word " * 40, tmp_path / "a.png")
    (figure,) = figures
    return figure


def test_each_bar_is_the_distance_of_its_landmark_in_mm(drawn: Figure) -> None:
    bars = drawn.axes[1]
    lengths = [bar.get_width() for bar in bars.patches]  # type: ignore[attr-defined]
    assert lengths == pytest.approx([1.0, 2.0, 3.0, 0.0], abs=1e-9)
    assert [label.get_text() for label in bars.get_yticklabels()] == list(PAIRS.names)
    at = {str(line.get_label()): float(np.ravel(line.get_xdata())[0]) for line in bars.get_lines()}
    assert at == {"mean 1.50 mm": pytest.approx(1.5), "limit of the mean 4.00 mm": pytest.approx(4.0)}


def test_vectors_begin_at_the_planned_landmarks_and_are_enlarged(drawn: Figure) -> None:
    scene = drawn.axes[0]
    assert f"enlarged {ENLARGED} times" in scene.get_title()
    assert {text.get_text().strip() for text in scene.texts} == set(PAIRS.names)


def test_a_long_verdict_is_wrapped(drawn: Figure) -> None:
    title = drawn.get_suptitle()
    assert title.startswith("Registration accepted")
    assert max(map(len, title.splitlines())) <= 110


def test_the_picture_is_a_png_in_the_named_file(tmp_path: Path) -> None:
    draw(PAIRS, BODY_REF_FROM_IMAGE, 0.004, "accepted", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(OSError, match="none"):
        draw(PAIRS, BODY_REF_FROM_IMAGE, 0.004, "accepted", tmp_path / "none" / "a.png")
