"""The table ``kst`` of the configuration."""

from __future__ import annotations

from math import hypot
from typing import Annotated, Literal

import msgspec

from pcmrs.devices.kst.cabinet import ImpedanceSettings

Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]
UNIT_TOLERANCE = 1e-6


class KstSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the cabinet is, and how the arm is streamed to.

    Attributes:
        host: Of the cabinet; a real one is 172.31.1.147 from the factory.
        port: Of the KST application on it.
        connect_timeout: Within which it must accept, s.
        reply_timeout: Within which it must answer every command, s; later the link is lost.
        rate_hz: Set points per second. A quarter of them asks for the joints, another quarter for the torques.
        mode: ``servo``: the arm is stiff; ``impedance``: compliant, as `impedance` says.
        impedance: The arm's compliance and the tool that it carries, in that mode.
        tool_axis: Unit vector of the tool's +z in the flange's axes: away from the patient, along which contact
            pushes and the force is relieved.
        brake_acceleration: Of every joint when held, rad/s^2.
        brake_jerk: Of every joint when held, rad/s^3.
        pose_limit: The arm is held when a joint is measured farther than this from where it was told to be at any
            moment of the last 0.2 s, rad.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, msgspec.Meta(ge=1, le=65535)] = 30001
    connect_timeout: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 3.0
    reply_timeout: Annotated[float, msgspec.Meta(gt=0.0, le=2.0)] = 0.5
    rate_hz: Annotated[float, msgspec.Meta(ge=200.0, le=1000.0)] = 200.0
    mode: Literal["servo", "impedance"] = "servo"
    impedance: ImpedanceSettings = ImpedanceSettings()
    tool_axis: Triple = (0.0, 0.0, -1.0)
    brake_acceleration: Positive = 10.0
    brake_jerk: Positive = 200.0
    pose_limit: Positive = 0.02

    def __post_init__(self) -> None:
        length = hypot(*self.tool_axis)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"tool_axis has length {length:g}, must be a unit vector")
