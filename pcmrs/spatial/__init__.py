"""Frames, rigid transforms and the frame graph."""

from pcmrs.spatial.frames import Frame
from pcmrs.spatial.graph import FrameGraph
from pcmrs.spatial.transform import Floats, Transform, distance, mean_transform, rotation_angle, trusted_transform

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
