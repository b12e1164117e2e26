"""A simulated scene in which nothing moves, and a registration that is exact."""

from __future__ import annotations

from pcmrs.messages import HeadMotion, PoseMessage, SceneTruth
from pcmrs.workflows.data import Registered

POSE = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
REGISTERED = Registered(
    id="r",
    body_ref_from_image=POSE,
    residual=0.0,
    rms=0.0,
    landmarks=(),
    digitized=(),
    patient="",
    calibration="",
)


class SceneAtRest:
    """A scene in which nothing moves; what was asked of it.

    Attributes:
        hidden: Bodies that were hidden or shown.
        motions: Motions of the head.
    """

    def __init__(self) -> None:
        self.hidden: list[tuple[str, bool]] = []
        self.motions: list[HeadMotion] = []

    async def truth(self) -> SceneTruth:
        return SceneTruth(tracker_from_coil=POSE, tracker_from_body_ref=POSE, body_ref_from_image=POSE)

    async def set_motion(self, motion: HeadMotion) -> None:
        self.motions.append(motion)

    async def occlude(self, body: str, hidden: bool) -> None:
        self.hidden.append((body, hidden))
