"""Present pose of a tracked body: poses arrive late, and a Kalman filter extrapolates them.

The state holds the rotation as a rotation, and its error and its rate as vectors in the tracker frame (Solà, Quaternion
Kinematics for the Error-State Kalman Filter, 2017). Translation and rotation are filtered independently.
"""

from __future__ import annotations

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial._constant_velocity import Noise, VelocityFilter
from pcmrs.spatial._transform import Floats, Transform, trusted_transform

__all__ = ["PosePredictor"]

JUMP_THRESHOLD = 30.0
"""Innovation over its standard deviation above which a frame is an outlier: 2.3 mm or 1.4° between frames at 60 Hz. A
head that starts at once with 86 mm/s moves by 1.4 mm between frames."""

MAX_OUTLIERS = 3
"""Number of consecutive outliers after which the body or its reference has moved: a glitch of the tracker is
shorter."""

HORIZON = 0.2
"""Longest extrapolation of a pose, s: longer than the tracker's latency and some lost frames."""

TRANSLATION = Noise(measurement=3e-5, rest=2e-6, motion=3e-3, rate=0.1)
ROTATION = Noise(measurement=np.radians(0.02), rest=3e-5, motion=0.3, rate=1.0)
"""Noise of rotations. In motion it equals that of translations with a lever arm of 0.1 m, about the distance of a
head's middle from its axis of nodding. At rest it is smaller: breathing hardly turns a head, and noise of the rotation
shakes a tool that follows far from the body's origin."""


class PosePredictor:
    """Filter and extrapolate the poses of one body. It reads no clock, so latency is contained in the time stamps.

    Poses are those of the body in the tracker frame (``tracker_from_body``), each with the time at which it was
    measured. A single outlier is skipped. `MAX_OUTLIERS` in a row latch the predictor until `reset`, so that nothing
    follows a reference that was bumped.

    Args:
        translation: Noise of translations; by default of an optical tracker (0.03 mm) on a head.
        rotation: Noise of rotations; by default 0.02°.
    """

    def __init__(self, translation: Noise = TRANSLATION, rotation: Noise = ROTATION) -> None:
        self._noise = (translation, rotation)
        self.reset()

    def reset(self) -> None:
        """Forget everything, so that the next pose is accepted at any place."""
        self._translation, self._rotation = (VelocityFilter(noise) for noise in self._noise)
        self._pose: Transform | None = None
        self._time = self._last_used_at = 0.0
        self._outliers = 0

    @property
    def velocity(self) -> Floats:
        """Velocity of the body's origin in the tracker frame, m/s, (3,)."""
        return self._translation.rate

    @property
    def angular_velocity(self) -> Floats:
        """Angular velocity of the body in the tracker frame, rad/s, (3,)."""
        return self._rotation.rate

    def update(self, time: float, pose: Transform) -> bool:
        """Take a measured pose.

        Args:
            time: Time at which the pose was measured, s, on the clock of `at`.
            pose: Measured ``tracker_from_body``.

        Returns:
            True if the pose was used, False if it was an outlier.

        Raises:
            RefusalError: ``pose_jump``: too many consecutive poses, now or earlier, were outliers; hold, then `reset`.
                ``pose_out_of_order``: the pose is not later than the previous one.
        """
        self._raise_if_jumped()
        if self._pose is None:
            self._pose, self._time, self._last_used_at = pose, time, time
            return True
        elapsed = time - self._time
        if elapsed <= 0.0:
            text = f"A pose of {time:.4f} s came after one of {self._time:.4f} s: pass on new frames only, in order."
            raise RefusalError("pose_out_of_order", text, time=time, previous=self._time)
        return self._correct(time, pose, predicted=self._extrapolated(self._pose, elapsed), elapsed=elapsed)

    def at(self, time: float) -> Transform:
        """Return ``tracker_from_body`` extrapolated to a time, s.

        Raises:
            RefusalError: ``pose_missing``: no pose was seen yet. ``pose_stale``: the last used pose is older than
                `HORIZON`. ``pose_jump``: see `update`.
        """
        self._raise_if_jumped()
        if self._pose is None:
            raise RefusalError("pose_missing", "No pose has been seen: wait for the tracker before predicting.")
        # Outliers move the prediction on, but do not extend the time for which it is valid.
        age = time - self._last_used_at
        if age > HORIZON:
            text = f"The last pose is {age:.3f} s old, the limit is {HORIZON:g} s: hold until the body is seen again."
            raise RefusalError("pose_stale", text, age=age, limit=HORIZON)
        return self._extrapolated(self._pose, time - self._time)

    def _correct(self, time: float, pose: Transform, *, predicted: Transform, elapsed: float) -> bool:
        """Correct the prediction by a pose, or keep the prediction if the pose is an outlier."""
        shift = pose.translation - predicted.translation
        turn = trusted_transform(pose.rotation @ predicted.rotation.T, np.zeros(3)).rotvec
        self._time = time
        if self._translation.is_outlier(JUMP_THRESHOLD, elapsed, shift) or self._rotation.is_outlier(
            JUMP_THRESHOLD, elapsed, turn
        ):
            self._pose, self._outliers = predicted, self._outliers + 1
            self._raise_if_jumped()
            return False
        self._pose = _moved(predicted, self._translation.correct(elapsed, shift), self._rotation.correct(elapsed, turn))
        self._last_used_at, self._outliers = time, 0
        return True

    def _extrapolated(self, pose: Transform, elapsed: float) -> Transform:
        return _moved(pose, elapsed * self.velocity, elapsed * self.angular_velocity)

    def _raise_if_jumped(self) -> None:
        if self._outliers >= MAX_OUTLIERS:
            text = (
                f"{MAX_OUTLIERS} poses in a row are more than {JUMP_THRESHOLD:g} standard deviations from where the "
                "body was going: it was moved or its reference bumped. Hold, check the registration, then restart."
            )
            raise RefusalError("pose_jump", text, outliers=self._outliers, limit=JUMP_THRESHOLD)


def _moved(pose: Transform, shift: Floats, turn: Floats) -> Transform:
    """Return a pose after a translation and a rotation vector, both in the parent frame.

    The rotation is about the body's origin.
    """
    moved = Transform.from_rotvec(pose.translation + shift, turn)
    return trusted_transform(moved.rotation @ pose.rotation, moved.translation)
