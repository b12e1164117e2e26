"""Frames, rigid transforms and the frame graph."""

from pcmrs.spatial._frames import Frame
from pcmrs.spatial._graph import FrameGraph
from pcmrs.spatial._transform import Floats, Transform, distance, mean_transform, rotation_angle, trusted_transform

__all__ = [
    "Floats",
    "Frame",
    "FrameGraph",
    "Transform",
    "distance",
    "mean_transform",
    "rotation_angle",
    "trusted_transform",
]
