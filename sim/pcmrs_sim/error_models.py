"""Seeded error models: of the arm, of the tracker, and of the person who touches landmarks."""

from __future__ import annotations

from dataclasses import replace
from math import pi, radians, sqrt

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.registration.rigid import fit_rigid
from pcmrs.spatial import Floats, Transform, trusted_transform
from pcmrs_sim.settings import DigitizationSettings, TrackerSettings, Triple

WAVES = 12
"""Number of plane waves in a bias field."""
SHORTEST_WAVE = 0.3
LONGEST_WAVE = 1.5
"""Range of their wavelengths, m. The bias hardly changes over the size of a marker body."""

BASELINE = 0.5
"""Distance between the two cameras of the tracker, m: about that of a Polaris Spectra or Vega."""
FEWEST_SPHERES = 3
"""Fewest spheres from which the pose of a body follows."""

ARM_STREAM = 1
"""Number of the random stream of the arm's geometry, so that it is independent of the other streams of a seed."""
REST_STREAM = 2
"""Number of the random stream of the places at which the arm comes to rest."""
REPEATABILITY = 2.0 * sqrt(2.0 / pi) + 3.0 * sqrt(3.0 - 8.0 / pi)
"""Repeatability by ISO 9283 over the standard deviation per axis: mean and deviation of a Maxwell distribution."""
SURFACE_STREAM = 1000
"""Number of the random stream of points on the skin. Streams of landmarks have their index, which is always smaller."""


def displaced(facts: ArmFacts, error: float, seed: int) -> ArmFacts:
    """Return the arm as it was built: each joint, and the flange, is displaced from its nominal position.

    In a random posture, the displacements have independent directions, so that their squares add up at the flange.

    Args:
        facts: Nominal geometry of the arm.
        error: Root of the sum of the squared displacements, m.
        seed: Seed of the displacements.
    """
    rng = np.random.default_rng((seed, ARM_STREAM))
    offsets = rng.normal(size=(len(facts.joints) + 1, 3))
    offsets *= error / np.linalg.norm(offsets)  # each seed has exactly this error, in other directions
    *at_joints, at_flange = offsets.tolist()
    joints = tuple(replace(joint, xyz=_add(joint.xyz, by)) for joint, by in zip(facts.joints, at_joints, strict=True))
    return replace(facts, joints=joints, flange_xyz=_add(facts.flange_xyz, at_flange))


def _add(xyz: Triple, offset: list[float]) -> Triple:
    x, y, z = (value + by for value, by in zip(xyz, offset, strict=True))
    return x, y, z


class RestingPlaces:
    """Displacements of the flange after each motion, which the joints do not show.

    ISO 9283 gives the repeatability as the mean distance from the mean place plus three times its standard deviation.
    For normal displacements, whose distances have a Maxwell distribution, that is `REPEATABILITY` standard deviations
    per axis.

    Args:
        repeatability: Pose repeatability, m.
        seed: Seed of the displacements.
    """

    def __init__(self, repeatability: float, seed: int) -> None:
        self._deviation = repeatability / REPEATABILITY
        self._rng = np.random.default_rng((seed, REST_STREAM))

    def draw(self) -> Floats:
        """Return the displacement after another motion, m, (3,)."""
        displacement: Floats = self._rng.normal(0.0, 1.0, 3) * self._deviation
        return displacement


class BiasField:
    """A smooth random vector field: a sum of plane waves with random directions.

    Args:
        magnitude: Root mean square of the vector's length over all positions.
        rng: Source of the waves.
    """

    def __init__(self, magnitude: float, rng: np.random.Generator) -> None:
        directions = rng.normal(size=(WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._wave_vectors = directions * (2 * np.pi / rng.uniform(SHORTEST_WAVE, LONGEST_WAVE, (WAVES, 1)))
        self._phases = rng.uniform(0.0, 2 * np.pi, WAVES)
        amplitudes = rng.normal(size=(WAVES, 3))
        # The mean square of a cosine is 1/2, and waves of different wave vectors are uncorrelated.
        self._amplitudes = amplitudes * (magnitude / np.sqrt(np.sum(amplitudes**2) / 2))

    def at(self, position: Floats) -> Floats:
        """Return the vector at a position, m, (3,)."""
        value: Floats = np.cos(self._wave_vectors @ position + self._phases) @ self._amplitudes
        return value


class TrackerErrors:
    """Errors that the tracker adds to a true pose.

    Each sphere has noise. Two cameras that are b apart see its direction with an error of s. At a distance r, that is
    ``r s`` across the line of sight, and ``2 r^2 s / b`` along it, because the disparity has twice the error of the
    mean of both directions (Hartley, Zisserman, Multiple View Geometry, 2004). So the pose is worse far away, with
    fewer spheres, and about axes across the line of sight.

    Args:
        settings: Magnitudes of the errors.
        rng: Source of the errors.

    Attributes:
        jitter_free: There is no jitter: all measurements of a body at rest are equal.
    """

    def __init__(self, settings: TrackerSettings, rng: np.random.Generator) -> None:
        self._rng = rng
        self._translation_bias = BiasField(settings.bias_mm * 1e-3, rng)
        self._rotation_bias = BiasField(radians(settings.bias_deg), rng)
        self._jitter = settings.jitter_mm * 1e-3
        self.jitter_free = not settings.jitter_mm

    def measure(
        self, tracker_from_body: Transform, spheres: Floats, seen: npt.NDArray[np.bool_]
    ) -> tuple[Transform, float]:
        """Return a measured pose and its fit error, m.

        The fit error is the rms distance of the seen spheres from where the pose puts them. It does not show the bias.

        Args:
            tracker_from_body: True pose of the marker body.
            spheres: Centres of its spheres, in its frame, m, (K, 3).
            seen: Mask of the spheres that are seen, (K,), at least `FEWEST_SPHERES`.
        """
        noise = self._jitter * self._rng.standard_normal(spheres.shape)  # of all spheres, so that seeds stay in step
        spheres = spheres[seen]
        measured = _with_noise(tracker_from_body @ spheres, noise[seen])
        fit = fit_rigid(measured, spheres)
        position = tracker_from_body.translation
        bias = Transform.from_rotvec(np.zeros(3), self._rotation_bias.at(position))
        pose = trusted_transform(bias.rotation @ fit.rotation, fit.translation + self._translation_bias.at(position))
        return pose, sqrt(float(fit.squares().mean()))


def _with_noise(points: Floats, noise: Floats) -> Floats:
    """Return points in the tracker frame, m, (K, 3), with noise of a distance of 1 m, m, (K, 3), at their distance."""
    distances = np.linalg.norm(points, axis=1, keepdims=True)
    sights = points / distances
    along = np.sum(noise * sights, axis=1, keepdims=True) * sights
    noisy: Floats = points + distances * (noise + (2.0 * distances / BASELINE - 1.0) * along)
    return noisy


class TouchErrors:
    """Errors of touches: a bias that is fixed for each landmark, and noise of each touch.

    Each landmark has its own generator, so that its errors depend only on the seed and on the number of its touches.

    Args:
        settings: Standard deviations per axis.
        seed: Seed of the errors.

    Attributes:
        surface: Source of touches anywhere on the skin: the touched points and their errors.
    """

    def __init__(self, settings: DigitizationSettings, seed: int) -> None:
        self._settings = settings
        self._seed = seed
        self.surface = np.random.default_rng((seed, SURFACE_STREAM))
        self._landmarks: dict[int, tuple[np.random.Generator, Floats]] = {}

    def next(self, index: int) -> Floats:
        """Draw touched minus planned position for the next touch of a landmark, in the image, m, (3,)."""
        if index not in self._landmarks:
            rng = np.random.default_rng((self._seed, index))
            self._landmarks[index] = rng, rng.normal(0.0, self._settings.planning_bias_mm * 1e-3, 3)
        rng, bias = self._landmarks[index]
        return bias + rng.normal(0.0, self._settings.noise_mm * 1e-3, 3)
