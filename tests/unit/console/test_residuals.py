"""Each landmark's residual as a number, and the predicted error as colours, as the daemon computes it."""

from __future__ import annotations

import io
import json

import msgspec
import numpy as np
import pytest
import trimesh

from pcmrs.console._residuals import coloured, colours, each_in_words, gradient, mean_in_words, predicted
from pcmrs.console.texts import Texts
from pcmrs.messages.setup import LandmarkShown, ProcedureDataView, SurfaceShown
from pcmrs.registration import predict_tre
from pcmrs.spatial import Transform
from pcmrs.workflows.data import as_message
from tests.unit.console.shown_cell import some_pose

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


LANDMARKS = np.array([(0.09, 0.0, 0.0), (0.0, 0.09, 0.0), (-0.09, 0.0, 0.0), (0.0, 0.0, 0.09)])
HEAD = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
DATA = ProcedureDataView(
    landmarks=[LandmarkShown(name=str(n), planned=tuple(point)) for n, point in enumerate(LANDMARKS.tolist())],
    body_ref_from_image=as_message(some_pose(1)),
    sigma=0.002,
)


def test_it_is_the_prediction_at_every_corner() -> None:
    found = predicted(DATA, np.array(HEAD.vertices))
    assert found == pytest.approx(predict_tre(LANDMARKS, HEAD.vertices, 0.002))


def test_a_refined_registration_has_its_own_covariance() -> None:
    translation = np.diag((0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6)).ravel().tolist()
    refined = msgspec.structs.replace(DATA, covariance=translation)
    assert predicted(refined, np.array(HEAD.vertices)) == pytest.approx(np.full(len(HEAD.vertices), np.sqrt(3e-6)))


def test_nothing_is_predicted_without_registration_or_landmarks() -> None:
    points = np.zeros((1, 3))
    assert predicted(msgspec.structs.replace(DATA, body_ref_from_image=None), points) is None
    assert predicted(msgspec.structs.replace(DATA, landmarks=DATA.landmarks[:2]), points) is None
    assert predicted(msgspec.structs.replace(DATA, landmarks=[]), points) is None


def test_browser_gets_brighter_colours_where_the_error_is_larger() -> None:
    surface = SurfaceShown(
        vertices=HEAD.vertices.astype("<f4").tobytes(), faces=HEAD.faces.astype("<u4").tobytes()
    )  # fmt: skip
    made = coloured(surface, DATA, 0.004)
    assert made is not None
    read = trimesh.load_scene(io.BytesIO(made), file_type="glb").to_mesh()
    assert read.volume == pytest.approx(HEAD.volume, rel=1e-5)
    errors = predicted(DATA, attribute(made, "POSITION", "<f4", 3).astype(float))
    assert errors is not None
    brightness = attribute(made, "COLOR_0", "u1", 4)[:, :3] @ (0.2126, 0.7152, 0.0722)
    assert np.corrcoef(np.argsort(np.argsort(errors)), np.argsort(np.argsort(brightness)))[0, 1] > 0.99


def attribute(glb: bytes, name: str, kind: str, columns: int) -> np.ndarray:
    """Of all corners, as the format has it: a header, JSON, and the numbers."""
    length = int.from_bytes(glb[12:16], "little")
    tree = json.loads(glb[20 : 20 + length])
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"][name]]
    start = tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return np.frombuffer(glb[28 + length :], kind, accessor["count"] * columns, start).reshape(-1, columns)


def test_colours_differ_in_brightness_enough_to_be_distinguished() -> None:
    shades = colours(np.linspace(-1.0, 2.0, 31)) @ (0.2126, 0.7152, 0.0722)
    assert np.all(np.diff(shades[10:21]) > 0.03)
    assert np.ptp(shades[:11]) == np.ptp(shades[20:]) == 0.0, "beyond the limit there is one colour"
    assert gradient().count("rgb(") == 9
