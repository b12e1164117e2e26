"""Registration of one frame to another from measured points."""

from pcmrs.registration.points import PointRegistration, register_points

__all__ = ["PointRegistration", "register_points"]
