"""The table ``kst`` of the configuration."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Literal

import msgspec

from pcmrs.devices.kst.connection import ImpedanceSettings

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]
UNIT_TOLERANCE = 1e-6


class KstSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Address of the cabinet, and parameters of the arm's motion.

    Attributes:
        host: Host name or address of the cabinet; the factory setting of a real one is 172.31.1.147.
        port: TCP port of the KST application.
        connect_timeout: Time within which the cabinet must accept, s.
        reply_timeout: Time within which the cabinet must answer each command, s; later the link is lost.
        rate_hz: Set points per second. A quarter of them requests the joints, another quarter the torques.
        motion: ``servo``: the arm follows a stream of set points, and can be stopped at any time; it needs the
            controller's servo option. ``ptp``: point-to-point motions in segments, without that option. A segment that
            has started cannot be stopped; it ends within 0.5 s. The arm cannot press, follow or be guided.
        mode: With `motion` ``servo``: ``servo`` for a stiff arm; ``impedance`` for a compliant one, see `impedance`.
        impedance: Compliance of the arm and load of the tool in mode ``impedance``.
        tool_axis: Unit vector of the tool's +z in the flange's axes: away from the patient, along which contact
            pushes and the force is relieved.
        brake_acceleration: Acceleration of each joint when the arm is held, rad/s^2.
        brake_jerk: Jerk of each joint when the arm is held, rad/s^3.
        pose_limit: Distance of a measured joint from its set points of the last 0.2 s, or from the range of the present
            segment, beyond which the arm is held, rad.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 30001
    connect_timeout: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 3.0
    reply_timeout: Annotated[float, msgspec.Meta(gt=0.0, le=2.0)] = 0.5
    rate_hz: Annotated[float, msgspec.Meta(ge=200.0, le=1000.0)] = 200.0
    motion: Literal["servo", "ptp"] = "servo"
    mode: Literal["servo", "impedance"] = "servo"
    impedance: ImpedanceSettings = ImpedanceSettings()
    tool_axis: Triple = (0.0, 0.0, -1.0)
    brake_acceleration: Positive = 10.0
    brake_jerk: Positive = 200.0
    pose_limit: Positive = 0.02

    def __post_init__(self) -> None:
        if self.motion == "ptp" and self.mode == "impedance":
            raise ValueError('mode is impedance, which is a stream; with motion = "ptp" leave mode at servo')
        length = hypot(*self.tool_axis)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"tool_axis has length {length:g}, must be a unit vector")
