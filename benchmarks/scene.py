"""Intrusions that the detector of the scene finds, after which time and at which distance, and false ones without any.

Run: ``python benchmarks/scene.py [INTRUSIONS [EMPTY]]``. The simulated depth camera sees the cell of ``ratms`` as
shipped. Each hand comes from a random direction, at 1 m/s, while the arm stands at another random posture; time counts
from the first image with its middle in the zone, in which it may be hidden. EMPTY images have a moving arm and no hand.
Everything runs in one process, image by image: no network, no daemon.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from pcmrs.config import as_table
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.scene.detector import IntrusionDetector
from pcmrs.scene_node import known_bodies
from pcmrs.settings import Settings, read_settings
from pcmrs.spatial import Floats
from pcmrs_sim.depth_camera import open_simulated

INTRUSIONS, EMPTY = 200, 2000
SPEED = 1.0
"""Speed of the hand, m/s."""
FROM_AFAR = 1.3
"""Distance from the middle of the zone at which a hand starts, m."""
STEEPEST = np.radians(60.0)
"""Largest angle of its way to the horizontal, rad."""
LOWEST = 0.05
"""Least height of any joint of a random posture above the base, m."""


class Bench:
    """Camera and detector, image by image."""

    def __init__(self, settings: Settings) -> None:
        own = settings.scene_camera
        self.arm = ArmModel(find_arm(settings.robot.model))
        self.home = np.array(self.arm.facts.home)
        self.joints: Floats = self.home
        self.period = 1.0 / own.rate_hz
        self.zone = own.zones[0]
        pose = own.pose.transform()
        self.camera = open_simulated(as_table(settings), lambda: self.joints, pose, own.rate_hz)
        self.detector = IntrusionDetector(own, self.camera.intrinsics, known_bodies(settings))
        self.times: list[tuple[float, float]] = []
        while not self.detector.learned:
            self.look()

    def look(self) -> bool:
        """Return True if an image shows an object for sure."""
        begin = time.perf_counter()
        frame = self.camera.look()
        middle = time.perf_counter()
        view = self.detector.look(frame, self.joints)
        self.times.append((middle - begin, time.perf_counter() - middle))
        return any(track.confidence >= 1.0 for track in view.tracks)

    def posture(self, rng: np.random.Generator) -> Floats:
        """Return a random posture above the bench, rad."""
        while True:
            q = self.home + rng.uniform(-0.6, 0.6, len(self.home))
            if self.arm.joint_origins(q)[1:, 2].min() > LOWEST:
                return np.asarray(q)

    def intrude(self, rng: np.random.Generator) -> tuple[float, float] | None:
        """Return the time until a hand is found, s, and its distance from the joints then, m; None if it is not."""
        self.joints, self.camera.hand = self.posture(rng), None
        for _ in range(6):  # earlier tracks end
            self.look()
        middle, size = np.array(self.zone.middle), np.array(self.zone.size)
        goal = middle + rng.uniform(-0.3, 0.3, 3) * size
        around, up = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, STEEPEST)
        direction = np.array((np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)))
        entered = None
        for step in range(int(FROM_AFAR / SPEED / self.period) + 15):
            left = max(0.0, FROM_AFAR - SPEED * step * self.period)
            hand = goal + left * direction
            self.camera.hand = (float(hand[0]), float(hand[1]), float(hand[2]))
            if entered is None and (np.abs(hand - middle) <= size / 2.0).all():
                entered = step
            if self.look():
                origins = self.arm.joint_origins(self.joints)
                late = 0 if entered is None else step - entered
                return late * self.period, float(np.linalg.norm(origins - hand, axis=1).min())
        return None


def main() -> None:
    """Print the table."""
    words = [int(word) for word in sys.argv[1:]]
    intrusions, empty = (*words, *(INTRUSIONS, EMPTY)[len(words) :])
    rng, bench = np.random.default_rng(1), Bench(read_settings())
    found = [bench.intrude(rng) for _ in range(intrusions)]
    seen = np.array([each for each in found if each is not None]).reshape(-1, 2)
    bench.camera.hand, false = None, 0
    for _ in range(6):
        bench.look()
    for number in range(empty):
        if number % 15 == 0:
            start, goal = bench.joints, bench.posture(rng)
        bench.joints = start + (goal - start) * (number % 15) / 15
        false += bench.look()
    print(f"intrusions found: {len(seen)} of {intrusions}")
    for name, values, unit in (("time", seen[:, 0] * 1e3, "ms"), ("distance from a joint", seen[:, 1] * 1e3, "mm")):
        low, half, high = np.percentile(values, (0, 50, 100))
        print(f"{name}: least {low:.0f}, median {half:.0f}, largest {high:.0f} {unit}")
    print(f"false ones in {empty} images ({empty * bench.period / 60:.0f} min) of a moving arm: {false}")
    cast, look = np.median(np.array(bench.times), axis=0) * 1e3
    print(f"median time per image: {cast:.1f} ms to simulate it, {look:.1f} ms to look at it")


if __name__ == "__main__":
    main()
