"""The frame graph: which transforms between frames are known now."""

from __future__ import annotations

import itertools

from pcmrs.errors import GeometryError, MissingTransformError
from pcmrs.spatial.frames import Frame
from pcmrs.spatial.transform import Transform


class FrameGraph:
    """Known transforms between frames, as a forest: at most one path joins two frames.

    One path means one answer: measured and calibrated transforms of a loop never agree exactly.
    """

    def __init__(self) -> None:
        self._edges: dict[Frame, dict[Frame, Transform]] = {frame: {} for frame in Frame}

    def set(self, parent: Frame, child: Frame, parent_from_child: Transform) -> None:
        """Sets or replaces the transform between two neighbours.

        Raises:
            GeometryError: The frames are the same, or already joined by other frames.
        """
        path = None if child in self._edges[parent] else self._path(parent, child)
        if path is not None:
            raise GeometryError(
                f"{parent} and {child} are already joined by {' - '.join(path)}; a second path would close a cycle. "
                "Clear a transform on that path first.",
                parent=parent,
                child=child,
            )
        self._edges[parent][child] = parent_from_child
        self._edges[child][parent] = parent_from_child.inverse()

    def clear(self, parent: Frame, child: Frame) -> None:
        """Forgets the transform between two neighbours, if it is known."""
        self._edges[parent].pop(child, None)
        self._edges[child].pop(parent, None)

    def get(self, target: Frame, source: Frame) -> Transform:
        """``target_from_source``, composed along the path.

        Raises:
            MissingTransformError: No known transforms join the two frames.
        """
        path = self._path(target, source)
        if path is None:
            raise MissingTransformError(
                f"No known transforms join {target} and {source}; set what is missing between them "
                "(a registration, a calibration or a measured pose).",
                target=target,
                source=source,
            )
        target_from_source = Transform.identity()
        for parent, child in itertools.pairwise(path):
            target_from_source = target_from_source @ self._edges[parent][child]
        return target_from_source

    def _path(self, start: Frame, end: Frame) -> list[Frame] | None:
        """Frames from `start` to `end`, both included; None when nothing joins them."""
        paths = [[start]]
        while paths:
            path = paths.pop()
            if path[-1] == end:
                return path
            paths += [[*path, frame] for frame in self._edges[path[-1]] if frame not in path]
        return None
