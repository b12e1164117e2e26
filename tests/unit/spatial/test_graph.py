import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError, MissingTransformError
from pcmrs.spatial import Frame, FrameGraph, Transform

FRAMES = list(Frame)
A = Transform.from_rotvec((1, 2, 3), (0.1, 0.2, 0.3))


@given(st.permutations(FRAMES), st.data())
def test_every_pair_of_a_random_tree_agrees_with_its_poses(frames: list[Frame], data: st.DataObject) -> None:
    seed = data.draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    world_from = {frame: Transform.from_rotvec(rng.normal(size=3), rng.normal(size=3)) for frame in frames}
    graph = FrameGraph()
    for index, child in enumerate(frames[1:], start=1):
        parent = frames[data.draw(st.integers(0, index - 1))]
        graph.set(parent, child, world_from[parent].inverse() @ world_from[child])
    for target, source in itertools.product(frames, repeat=2):
        expected = world_from[target].inverse() @ world_from[source]
        np.testing.assert_allclose(graph.get(target, source).matrix, expected.matrix, atol=1e-12)


def test_a_second_path_is_refused_and_changes_nothing() -> None:
    graph = FrameGraph()
    graph.set(Frame.TOOL_TIP, Frame.TOOL_MARKER, A)
    graph.set(Frame.TRACKER, Frame.TOOL_MARKER, A)
    with pytest.raises(GeometryError, match="tool_tip - coil - tracker"):
        graph.set(Frame.TOOL_TIP, Frame.TRACKER, A)
    with pytest.raises(GeometryError, match="cycle"):
        graph.set(Frame.TOOL_TIP, Frame.TOOL_TIP, A)
    np.testing.assert_allclose(graph.get(Frame.TOOL_TIP, Frame.TRACKER).matrix, np.eye(4), atol=1e-15)


def test_a_transform_is_replaced_from_either_side() -> None:
    graph = FrameGraph()
    graph.set(Frame.TOOL_TIP, Frame.TOOL_MARKER, Transform.identity())
    graph.set(Frame.TOOL_MARKER, Frame.TOOL_TIP, A)
    np.testing.assert_allclose(graph.get(Frame.TOOL_TIP, Frame.TOOL_MARKER).matrix, A.inverse().matrix, atol=1e-15)


def test_frames_without_a_connection_are_named() -> None:
    graph = FrameGraph()
    graph.set(Frame.TRACKER, Frame.REFERENCE, A)
    graph.set(Frame.REFERENCE, Frame.IMAGE, A)
    graph.clear(Frame.IMAGE, Frame.REFERENCE)
    graph.clear(Frame.IMAGE, Frame.WORLD)
    with pytest.raises(MissingTransformError, match="tracker and image") as caught:
        graph.get(Frame.TRACKER, Frame.IMAGE)
    assert caught.value.fields == {"target": "tracker", "source": "image"}
    assert graph.get(Frame.TRACKER, Frame.REFERENCE) is not None


def test_a_frame_in_itself_is_the_identity() -> None:
    np.testing.assert_array_equal(FrameGraph().get(Frame.TOOL_MARKER, Frame.TOOL_MARKER).matrix, np.eye(4))
