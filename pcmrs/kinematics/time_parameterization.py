"""Time parameterization: progress along a path over time, at speeds that depend on the place.

Ruckig plans motions with limits that are constant along the path (L. Berscheid, T. Kröger, Jerk-limited Real-time
Trajectory Generation with Arbitrary Target States, RSS 2021). The path is therefore cut into sections of constant
limits. The progress passes their borders without acceleration, at the greatest speed from which every later section can
still be braked. A forward and a backward pass find these speeds, as in J. Bobrow, S. Dubowsky, J. Gibson, Time-Optimal
Control of Robotic Manipulators Along Specified Paths, IJRR 4 (1985).

Cubic splines follow C. de Boor, A Practical Guide to Splines, Springer 1978, chapter IV. SciPy has them, too, but
importing `scipy.interpolate` takes longer than everything else that a process needs to follow a motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np
import numpy.typing as npt
from ruckig import InputParameter, Ruckig, RuckigError, Synchronization, Trajectory

from pcmrs.errors import GeometryError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

PERIOD = 0.005  # s between the samples of a trajectory
_SPEED_RESERVE = 1e-6  # share of a border's speed, so that rounding leaves the section a solution

SpeedLimitAt = Callable[[Floats], Floats]
"""Greatest speed of flange and tool point, m/s, (K,), at joint positions rad, (K, n). It takes few different values."""


class CubicSpline:
    """Cubic spline through rows of numbers, with two continuous derivatives.

    Args:
        places: Ascending places of the rows, (K,): at least four, or at least two if `ends` are given.
        rows: Values at the places, (K, n).
        ends: Slopes at the first and at the last place, (n,) each. With None, the first two intervals share one cubic,
            and so do the last two ("not a knot").

    Attributes:
        places: Places of the rows, (K,).
    """

    def __init__(
        self, places: npt.ArrayLike, rows: npt.ArrayLike, ends: tuple[npt.ArrayLike, npt.ArrayLike] | None = None
    ) -> None:
        self.places: Floats = np.asarray(places, dtype=float)
        self._rows: Floats = np.asarray(rows, dtype=float)
        self._steps: Floats = np.diff(self.places)
        self._slopes = _slopes(self._steps, self._rows, ends)

    def __call__(self, places: npt.ArrayLike, order: int = 0) -> Floats:
        """Return the value or a derivative of the spline, (M, n).

        Args:
            places: Places at which it is evaluated, (M,).
            order: 0 for the value, 1 or 2 for that derivative.
        """
        places = np.asarray(places, dtype=float)
        left = np.clip(np.searchsorted(self.places, places, side="right") - 1, 0, len(self._steps) - 1)
        step, offset = self._steps[left, None], (places - self.places[left])[:, None]
        start, slope = self._rows[left], self._slopes[left]
        chord = (self._rows[left + 1] - start) / step
        excess = (slope + self._slopes[left + 1] - 2.0 * chord) / step
        third, second = excess / step, (chord - slope) / step - excess
        value: Floats = (
            start + offset * (slope + offset * (second + offset * third)),
            slope + offset * (2.0 * second + offset * 3.0 * third),
            2.0 * second + offset * 6.0 * third,
        )[order]
        return value


def _slopes(steps: Floats, rows: Floats, ends: tuple[npt.ArrayLike, npt.ArrayLike] | None) -> Floats:
    """Return the slopes at all places, (K, n), with which the second derivative is continuous."""
    chords = np.diff(rows, axis=0) / steps[:, None]
    below, above = np.append(steps[1:], 0.0), np.append(0.0, steps[:-1])
    main = np.concatenate(((1.0,), 2.0 * (steps[1:] + steps[:-1]), (1.0,)))
    right = np.empty_like(rows)
    right[1:-1] = 3.0 * (steps[1:, None] * chords[:-1] + steps[:-1, None] * chords[1:])
    if ends is None:
        (main[0], above[0], right[0]) = _not_a_knot(steps[0], steps[1], chords[0], chords[1])
        (main[-1], below[-1], right[-1]) = _not_a_knot(steps[-1], steps[-2], chords[-1], chords[-2])
    else:
        right[0], right[-1] = ends
    return _solve_tridiagonal(below.tolist(), main.tolist(), above.tolist(), right)


def _solve_tridiagonal(below: list[float], main: list[float], above: list[float], right: Floats) -> Floats:
    """Solve for all columns of `right`, (K, n), by elimination without pivoting.

    A spline's matrix needs no pivots (de Boor, chapter IV). SciPy solves this, too, but takes long to load.

    Args:
        below: Coefficients left of the diagonal, of the rows from the second on, (K - 1,).
        main: Diagonal, (K,).
        above: Coefficients right of the diagonal, of the rows up to the last but one, (K - 1,).
        right: Right-hand sides; overwritten.
    """
    for row, coefficient in enumerate(below):
        share = coefficient / main[row]
        main[row + 1] -= share * above[row]
        right[row + 1] -= share * right[row]
    right[-1] /= main[-1]
    for row in range(len(above) - 1, -1, -1):
        right[row] = (right[row] - above[row] * right[row + 1]) / main[row]
    return right


def _not_a_knot(near: float, next_: float, chord: Floats, next_chord: Floats) -> tuple[float, float, Floats]:
    """Return the two coefficients and the right-hand side by which the two intervals at an end share one cubic."""
    both = near + next_
    return next_, both, ((near + 2.0 * both) * next_ * chord + near**2 * next_chord) / both


def joint_request(velocity: Floats, limits: MotionLimits) -> InputParameter:
    """Return Ruckig's request for a motion of all joints along a straight line of joint space.

    Args:
        velocity: Greatest speed of each joint, rad/s, (n,).
        limits: Greatest accelerations and jerks of the joints.
    """
    request = InputParameter(len(velocity))
    request.synchronization = Synchronization.Phase
    request.max_velocity = velocity.tolist()
    request.max_acceleration = list(limits.joint_acceleration)
    request.max_jerk = list(limits.joint_jerk)
    return request


def solve(request: InputParameter) -> Trajectory:
    """Return the fastest profile for a request.

    Raises:
        GeometryError: There is none.
    """
    try:
        return _calculated(request)
    except RuckigError:
        # Ruckig finds no profile if the greatest acceleration is reached for an instant only: a distance of
        # 2 a^3 / j^2 between two places at rest. A slightly smaller one is within the limits, too.
        request.max_acceleration = [(1.0 - 1e-6) * each for each in request.max_acceleration]
    try:
        return _calculated(request)
    except RuckigError as error:
        raise GeometryError(f"No motion profile exists: {error}; check positions, velocities and limits.") from error


def _calculated(request: InputParameter) -> Trajectory:
    profile = Trajectory(request.degrees_of_freedom)
    Ruckig(request.degrees_of_freedom).calculate(request, profile)
    return profile


def sample_times(duration: float, stretch: float, period: float) -> Floats:
    """Return the times at which to sample a profile so that one sample per period plays it `stretch` times slower, s.

    Args:
        duration: Duration of the profile, s.
        stretch: Factor on the duration, at least 1.
        period: Time between samples, s.
    """
    return np.linspace(0.0, duration, max(1, ceil(duration * stretch / period)) + 1)


@dataclass(frozen=True)
class ProgressLimits:
    """Greatest derivatives of the progress, which goes from 0 to 1.

    Attributes:
        velocity: Greatest speed, 1/s.
        acceleration: Greatest acceleration, 1/s².
        jerk: Greatest jerk, 1/s³.
    """

    velocity: float
    acceleration: float
    jerk: float


@dataclass(frozen=True, eq=False)
class ProgressProfile:
    """Progress from 0 to 1, from rest to rest.

    Attributes:
        starts: Start times of the sections, and the end time of the last one, s, (S + 1,).
        borders: Progress at these times, (S + 1,).
        sections: Ruckig's profile of each section, relative to its first border, (S,).
    """

    starts: Floats
    borders: Floats
    sections: tuple[Trajectory, ...]

    @property
    def duration(self) -> float:
        """Time from rest to rest, s."""
        return float(self.starts[-1])

    def at(self, times: npt.ArrayLike) -> Floats:
        """Return the progress at times, s, (M,)."""
        times = np.asarray(times, dtype=float)
        numbers = np.clip(np.searchsorted(self.starts, times, side="right") - 1, 0, len(self.sections) - 1)
        moved = [
            self.sections[number].at_time(min(time, self.sections[number].duration))[0][0]
            for number, time in zip(numbers.tolist(), (times - self.starts[numbers]).tolist(), strict=True)
        ]
        return np.asarray(np.clip(self.borders[numbers] + np.array(moved), 0.0, 1.0))


def speed_limits_at(postures: Floats, limits: MotionLimits, speed_limit_at: SpeedLimitAt | None) -> Floats:
    """Return the greatest speed of flange and tool point at each posture, m/s, (K,).

    Args:
        postures: Joint positions, rad, (K, n).
        limits: Limits that hold everywhere.
        speed_limit_at: Lower speed limits at some postures.
    """
    everywhere = np.full(len(postures), limits.linear_velocity)
    return everywhere if speed_limit_at is None else np.minimum(everywhere, speed_limit_at(postures))


def tool_path_lengths(arm: ArmModel, postures: Floats, flange_from_tool: Transform) -> Floats:
    """Return the distance that flange or tool point, whichever moves farther, moves between postures, m, (K - 1,).

    Args:
        arm: Model of the arm.
        postures: Joint positions, rad, (K, n).
        flange_from_tool: Pose of the tool point in the flange.
    """
    flanges = [arm.forward(q) for q in postures]
    points = np.array([(flange.translation, flange @ flange_from_tool.translation) for flange in flanges])
    return np.asarray(np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1))


def time_parameterize(places: Floats, path_lengths: Floats, allowed: Floats, bounds: ProgressLimits) -> ProgressProfile:
    """Return the fastest progress that keeps its own bounds and the speed limit at each place.

    Args:
        places: Ascending progress from 0 to 1, (K,).
        path_lengths: Distance that the tool moves from each place to the next, m, (K - 1,).
        allowed: Greatest speed of the tool at each place, m/s, (K,).
        bounds: Limits of the progress that hold everywhere.
    """
    levels = np.minimum(allowed[1:], allowed[:-1])
    rates = np.maximum(path_lengths, np.finfo(float).tiny) / np.diff(places)
    speeds = np.minimum(bounds.velocity, levels / rates)
    # Successive intervals with the same limit form one section, whose progress is limited by its slowest interval.
    starts = np.concatenate(((0,), 1 + np.flatnonzero(np.diff(levels))))
    lengths = np.diff(np.append(places[starts], 1.0))
    limits = np.minimum.reduceat(speeds, starts)
    borders = _border_speeds(lengths, limits, bounds)
    sections = [
        _section(length, limit, (begin, end), bounds)
        for length, limit, begin, end in zip(lengths, limits, borders[:-1], borders[1:], strict=True)
    ]
    times = np.concatenate(((0.0,), np.cumsum([section.duration for section in sections])))
    return ProgressProfile(times, np.append(places[starts], 1.0), tuple(sections))


def _border_speeds(lengths: Floats, limits: Floats, bounds: ProgressLimits) -> Floats:
    """Return the greatest speeds at the borders of sections, 1/s, (S + 1,), 0 at both ends."""
    speeds = np.concatenate(((0.0,), np.minimum(limits[1:], limits[:-1]), (0.0,)))
    # Forward: no border is faster than can be reached from the previous one.
    for number, length in enumerate(lengths[:-1]):
        speeds[number + 1] = min(speeds[number + 1], _reachable_speed(speeds[number], float(length), bounds))
    # Backward: no border is so fast that the next one is missed.
    for number in range(len(lengths) - 1, 0, -1):
        speeds[number] = min(speeds[number], _reachable_speed(speeds[number + 1], float(lengths[number]), bounds))
    return speeds * (1.0 - _SPEED_RESERVE)


def _reachable_speed(speed: float, length: float, bounds: ProgressLimits) -> float:
    """Return the greatest speed, 1/s, to which `speed` can rise, or from which it can be reached, within a length."""
    fastest = speed + bounds.velocity
    if _needed_length(speed, fastest, bounds) <= length:
        return fastest
    slow, fast = speed, fastest
    while slow < (middle := 0.5 * (slow + fast)) < fast:  # bisection until no number is between both
        slow, fast = (middle, fast) if _needed_length(speed, middle, bounds) <= length else (slow, middle)
    return slow


def _needed_length(slow: float, fast: float, bounds: ProgressLimits) -> float:
    """Return the progress made during a change of speed without acceleration at either end: mean speed times time."""
    change = fast - slow
    if change * bounds.jerk <= bounds.acceleration**2:
        time = 2.0 * sqrt(change / bounds.jerk)
    else:
        time = change / bounds.acceleration + bounds.acceleration / bounds.jerk
    return 0.5 * (slow + fast) * time


def _section(length: float, limit: float, speeds: tuple[float, float], bounds: ProgressLimits) -> Trajectory:
    request = InputParameter(1)
    request.current_velocity, request.target_velocity = [speeds[0]], [speeds[1]]
    request.target_position = [length]
    request.max_velocity, request.max_acceleration = [limit], [bounds.acceleration]
    request.max_jerk = [bounds.jerk]
    return solve(request)
