"""Frame graph: the transforms between frames that are known now."""

from __future__ import annotations

import itertools

from pcmrs.errors import GeometryError, MissingTransformError
from pcmrs.spatial._frames import Frame
from pcmrs.spatial._transform import Transform


class FrameGraph:
    """Known transforms between frames, as a forest: at most one path joins two frames.

    One path gives one answer. Measured and calibrated transforms of a loop would never agree exactly.
    """

    def __init__(self) -> None:
        self._edges: dict[Frame, dict[Frame, Transform]] = {frame: {} for frame in Frame}

    def set(self, parent: Frame, child: Frame, parent_from_child: Transform) -> None:
        """Set or replace the transform between two neighbours.

        Args:
            parent: First frame.
            child: Second frame.
            parent_from_child: Pose of the second frame in the first.

        Raises:
            GeometryError: The frames are the same, or other frames already join them.
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
        """Remove the transform between two neighbours if it is known.

        Args:
            parent: First frame.
            child: Second frame.
        """
        self._edges[parent].pop(child, None)
        self._edges[child].pop(parent, None)

    def get(self, target: Frame, source: Frame) -> Transform:
        """Return ``target_from_source``, composed along the path.

        Args:
            target: Frame in which the pose is wanted.
            source: Frame whose pose is wanted.

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
        """Return the frames from `start` to `end`, both included, or None if no path joins them."""
        # The order of the search does not matter, because a forest has at most one path.
        paths = [[start]]
        while paths:
            path = paths.pop()
            if path[-1] == end:
                return path
            paths += [[*path, frame] for frame in self._edges[path[-1]] if frame not in path]
        return None
