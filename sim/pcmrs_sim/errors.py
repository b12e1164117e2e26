"""Seeded error models: of the arm, of the tracker, and of the person who touches landmarks."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.spatial import Floats, Transform, trusted_transform
from pcmrs_sim.settings import DigitizationSettings, TrackerSettings, Triple

WAVES = 12
SHORTEST_WAVE = 0.3  # m; the bias hardly changes over the size of a marker body
LONGEST_WAVE = 1.5  # m


ARM_STREAM = 1
"""Keeps the draws of the arm's geometry apart from all others of a seed."""
SURFACE_STREAM = 1000
"""The same for points of the skin: no landmark has so high an index."""


def displaced(facts: ArmFacts, error: float, seed: int) -> ArmFacts:
    """The arm as it was built: every joint, and the flange, sits beside where the model has it.

    The joints turn the displacements against each other, so that their squares add up at the flange.

    Args:
        facts: The arm as its model has it.
        error: Root of the sum of the squared displacements, m.
        seed: Where they come from.
    """
    rng = np.random.default_rng((seed, ARM_STREAM))
    offsets = rng.normal(size=(len(facts.joints) + 1, 3))
    offsets *= error / np.linalg.norm(offsets)
    *at_joints, at_flange = offsets.tolist()
    joints = tuple(replace(joint, xyz=_add(joint.xyz, by)) for joint, by in zip(facts.joints, at_joints, strict=True))
    return replace(facts, joints=joints, flange_xyz=_add(facts.flange_xyz, at_flange))


def _add(xyz: Triple, offset: list[float]) -> Triple:
    x, y, z = (value + by for value, by in zip(xyz, offset, strict=True))
    return x, y, z


class BiasField:
    """A smooth random vector function of place: a sum of plane waves with random directions.

    Args:
        magnitude: Root mean square of the vector's length over all places.
        rng: Where the waves come from.
    """

    def __init__(self, magnitude: float, rng: np.random.Generator) -> None:
        directions = rng.normal(size=(WAVES, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._wave_vectors = directions * (2 * np.pi / rng.uniform(SHORTEST_WAVE, LONGEST_WAVE, (WAVES, 1)))
        self._phases = rng.uniform(0.0, 2 * np.pi, WAVES)
        amplitudes = rng.normal(size=(WAVES, 3))
        # The mean square of a cosine is 1/2, and waves of different wave vectors are uncorrelated.
        self._amplitudes = amplitudes * (magnitude / np.sqrt(np.sum(amplitudes**2) / 2))

    def at(self, place: Floats) -> Floats:
        """The vector at `place`, m, (3,)."""
        value: Floats = np.cos(self._wave_vectors @ place + self._phases) @ self._amplitudes
        return value


class TrackerErrors:
    """What the tracker adds to a true pose.

    Args:
        settings: Magnitudes of the errors.
        rng: Where they come from.

    Attributes:
        steady: Without jitter: what does not move is measured the same in every frame.
    """

    def __init__(self, settings: TrackerSettings, rng: np.random.Generator) -> None:
        self._rng = rng
        self._translation_bias = BiasField(settings.bias_mm * 1e-3, rng)
        self._rotation_bias = BiasField(radians(settings.bias_deg), rng)
        self._translation_jitter = settings.jitter_mm * 1e-3
        self._rotation_jitter = radians(settings.jitter_deg)
        self.steady = not (settings.jitter_mm or settings.jitter_deg)

    def measure(self, tracker_from_body: Transform) -> Transform:
        """One measurement of a true pose: bias of its place plus fresh jitter, in the tracker's axes."""
        place = tracker_from_body.translation
        translation = self._translation_bias.at(place) + self._rng.normal(0.0, self._translation_jitter, 3)
        rotation = self._rotation_bias.at(place) + self._rng.normal(0.0, self._rotation_jitter, 3)
        turned = Transform.from_rotvec((0.0, 0.0, 0.0), rotation).rotation @ tracker_from_body.rotation
        return trusted_transform(turned, place + translation)

    def fit_error(self) -> float:
        """What the tracker itself thinks of one measurement, m: the scatter of its markers, without the bias."""
        return float(np.linalg.norm(self._rng.normal(0.0, self._translation_jitter, 3)))


class TouchErrors:
    """Where a touch lands beside the planned landmark: a bias fixed per landmark, and noise of each touch.

    Every landmark has a generator of its own, so that its errors depend on the seed and on how often it was touched,
    and on nothing else.

    Args:
        settings: Deviations per axis.
        seed: Where they come from.

    Attributes:
        surface: Where on the skin a person touches who may touch anywhere, and how far beside it.
    """

    def __init__(self, settings: DigitizationSettings, seed: int) -> None:
        self._settings = settings
        self._seed = seed
        self.surface = np.random.default_rng((seed, SURFACE_STREAM))
        self._landmarks: dict[int, tuple[np.random.Generator, Floats]] = {}

    def next(self, index: int) -> Floats:
        """Touched minus planned position of landmark `index` at its next touch, in the image, m, (3,)."""
        if index not in self._landmarks:
            rng = np.random.default_rng((self._seed, index))
            self._landmarks[index] = rng, rng.normal(0.0, self._settings.planning_bias_mm * 1e-3, 3)
        rng, bias = self._landmarks[index]
        return bias + rng.normal(0.0, self._settings.noise_mm * 1e-3, 3)
