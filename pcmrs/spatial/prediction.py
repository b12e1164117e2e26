"""Where a tracked body is now: poses arrive late, and a Kalman filter extrapolates them.

The rotation is kept as a rotation, its error and its rate as vectors in the tracker frame (Solà, Quaternion Kinematics
for the Error-State Kalman Filter, 2017); translation and rotation are filtered each by itself.
"""

from __future__ import annotations

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial.constant_velocity import Noise, VelocityFilter
from pcmrs.spatial.transform import Floats, Transform

JUMP = 30.0
"""Innovation against its standard deviation above which a frame is an outlier: 2.3 mm or 1.4° between frames at 60 Hz,
where a head that starts at 86 mm/s without any acceleration makes 1.4 mm."""

OUTLIERS = 3
"""So many outliers in a row are no glitch of the tracker: the body, or its reference, is elsewhere."""

HORIZON = 0.2
"""A pose is extrapolated so far at most, s: longer than tracker latency and some lost frames."""

TRANSLATION = Noise(measurement=3e-5, rest=2e-6, motion=3e-3, rate=0.1)
ROTATION = Noise(measurement=np.radians(0.02), rest=3e-5, motion=0.3, rate=1.0)
"""In motion as translations with a lever arm of 0.1 m, about the distance of a head's middle from where it nods about.
At rest less: breathing hardly turns a head, and the noise of a rotation shakes what follows it far from its origin."""


class PosePredictor:
    """Follows the poses of one body and extrapolates them; knows no clock, so latency is in the stamps.

    Poses are those of the body in the tracker frame (``tracker_from_body``), each with the time at which it was taken.
    A single outlier is passed over; `OUTLIERS` in a row latch the predictor until `reset`, so that nothing follows a
    reference that was bumped.

    Args:
        translation: Noise of translations; the default is an optical tracker (0.03 mm) on a head.
        rotation: Noise of rotations; by default 0.02°.
    """

    def __init__(self, translation: Noise = TRANSLATION, rotation: Noise = ROTATION) -> None:
        self._noise = (translation, rotation)
        self.reset()

    def reset(self) -> None:
        """Forgets everything: the next pose begins anew, wherever it is."""
        self._translation, self._rotation = (VelocityFilter(noise) for noise in self._noise)
        self._pose: Transform | None = None
        self._time = self._seen = 0.0
        self._outliers = 0

    @property
    def velocity(self) -> Floats:
        """Of the body's origin in the tracker frame, m/s, (3,)."""
        return self._translation.rate

    @property
    def angular_velocity(self) -> Floats:
        """In the tracker frame, rad/s, (3,)."""
        return self._rotation.rate

    def update(self, time: float, pose: Transform) -> bool:
        """Takes a measured pose.

        Args:
            time: When it was taken, s, on the clock of `at`.
            pose: ``tracker_from_body``.

        Returns:
            Whether it was used; an outlier is not.

        Raises:
            RefusalError: ``pose_jump``: this was one outlier too many, now or before; hold, then `reset`.
                ``pose_out_of_order``: it is not later than the pose before.
        """
        self._refuse_jumped()
        if self._pose is None:
            self._pose, self._time, self._seen = pose, time, time
            return True
        passed = time - self._time
        if passed <= 0.0:
            text = f"A pose of {time:.4f} s came after one of {self._time:.4f} s: pass on new frames only, in order."
            raise RefusalError("pose_out_of_order", text, time=time, previous=self._time)
        return self._take(time, pose, predicted=self._extrapolated(self._pose, passed), passed=passed)

    def at(self, time: float) -> Transform:
        """The pose extrapolated to a time.

        Raises:
            RefusalError: ``pose_missing``: nothing was seen yet. ``pose_stale``: the last pose used is more than
                `HORIZON` older. ``pose_jump``: see `update`.
        """
        self._refuse_jumped()
        if self._pose is None:
            raise RefusalError("pose_missing", "No pose has been seen: wait for the tracker before predicting.")
        age = time - self._seen
        if age > HORIZON:
            text = f"The last pose is {age:.3f} s old, the limit is {HORIZON:g} s: hold until the body is seen again."
            raise RefusalError("pose_stale", text, age=age, limit=HORIZON)
        return self._extrapolated(self._pose, time - self._time)

    def _take(self, time: float, pose: Transform, *, predicted: Transform, passed: float) -> bool:
        """Corrects the prediction by a pose, or goes on with the prediction where the pose is an outlier."""
        shift = pose.translation - predicted.translation
        turn = Transform(pose.rotation @ predicted.rotation.T, np.zeros(3)).rotvec
        self._time = time
        if self._translation.exceeds(JUMP, passed, shift) or self._rotation.exceeds(JUMP, passed, turn):
            self._pose, self._outliers = predicted, self._outliers + 1
            self._refuse_jumped()
            return False
        self._pose = _moved(predicted, self._translation.correct(passed, shift), self._rotation.correct(passed, turn))
        self._seen, self._outliers = time, 0
        return True

    def _extrapolated(self, pose: Transform, passed: float) -> Transform:
        return _moved(pose, passed * self.velocity, passed * self.angular_velocity)

    def _refuse_jumped(self) -> None:
        if self._outliers >= OUTLIERS:
            text = (
                f"{OUTLIERS} poses in a row are more than {JUMP:g} standard deviations from where the body was going: "
                "it was moved or its reference bumped. Hold, check the registration, then begin anew."
            )
            raise RefusalError("pose_jump", text, outliers=self._outliers, limit=JUMP)


def _moved(pose: Transform, shift: Floats, turn: Floats) -> Transform:
    """The pose after a translation and a rotation vector, both in the parent frame and about the body's origin."""
    return Transform.from_rotvec(pose.translation + shift, turn) @ Transform(pose.rotation, np.zeros(3))
