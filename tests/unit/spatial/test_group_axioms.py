"""Rigid transforms are a group under composition."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Transform

coordinates = st.tuples(*[st.floats(-10.0, 10.0)] * 3)
transforms = st.builds(Transform.from_rotvec, coordinates, st.tuples(*[st.floats(-1.8, 1.8)] * 3))


def same(a: Transform, b: Transform) -> None:
    np.testing.assert_allclose(a.matrix, b.matrix, atol=1e-12)


@given(transforms, transforms)
def test_a_composition_is_a_rigid_transform(a: Transform, b: Transform) -> None:
    Transform(*((a @ b).rotation, (a @ b).translation))  # refuses what is none


@given(transforms, transforms, transforms)
def test_composition_is_associative(a: Transform, b: Transform, c: Transform) -> None:
    same((a @ b) @ c, a @ (b @ c))


@given(transforms)
def test_the_identity_is_neutral(a: Transform) -> None:
    same(a @ Transform.identity(), a)
    same(Transform.identity() @ a, a)


@given(transforms, transforms)
def test_inverses_are_two_sided_and_turn_the_order_round(a: Transform, b: Transform) -> None:
    same(a @ a.inverse(), Transform.identity())
    same(a.inverse() @ a, Transform.identity())
    same((a @ b).inverse(), b.inverse() @ a.inverse())
