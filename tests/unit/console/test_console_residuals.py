"""How well the registration fits stands on the page as numbers, each landmark's with its name."""

from __future__ import annotations

import msgspec
import numpy as np

from pcmrs.console.residuals import each_in_words, mean_in_words
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_message

LIMIT = 0.003
BODY_REF_FROM_IMAGE = Transform.from_rotvec((0.1, -0.2, 0.3), (0.2, 0.1, -0.4))


def landmark(name: str, planned: tuple[float, float, float], off: float | None) -> LandmarkShown:
    """One that was digitized `off` m from where the registration has it."""
    x, y, z = (BODY_REF_FROM_IMAGE @ np.array(planned)).tolist()
    return LandmarkShown(name=name, planned=planned, digitized=None if off is None else (x, y + off, z))


REGISTERED = ProcedureDataView(
    landmarks=[
        landmark("nasion", (0.0, 0.1, 0.0), 0.00123),
        landmark("inion", (0.0, -0.1, 0.0), None),
        landmark("left", (0.07, 0.0, 0.0), 0.00456),
    ],
    body_ref_from_image=as_message(BODY_REF_FROM_IMAGE),
    residual=0.002895,
)


def test_each_landmark_shows_its_residual_and_if_it_is_too_large() -> None:
    assert mean_in_words(REGISTERED, LIMIT, Texts("en")) == "Residual: 2.90 mm (limit 3.0 mm)"
    assert each_in_words(REGISTERED, LIMIT, Texts("en")) == [
        ("nasion 1.23 mm", True),
        ("left 4.56 mm, beyond 3.0 mm", False),
    ]
    assert mean_in_words(REGISTERED, LIMIT, Texts("de")) == "Restfehler: 2.90 mm (Grenze 3.0 mm)"
    assert each_in_words(REGISTERED, LIMIT, Texts("de"))[1] == ("left 4.56 mm, über 3.0 mm", False)


def test_no_residual_is_shown_before_a_registration() -> None:
    planned = msgspec.structs.replace(REGISTERED, body_ref_from_image=None, residual=None)
    assert mean_in_words(planned, LIMIT, Texts("en")) == ""
    assert each_in_words(planned, LIMIT, Texts("en")) == []
