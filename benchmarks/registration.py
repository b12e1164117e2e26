"""Point-based registration: accuracy and time, compared with SciPy, scikit-surgerycore, SimpleITK and VTK in one run.

Each gets NumPy arrays (N, 3) and returns a rotation matrix and a translation; converting the points into a peer's own
containers is part of its time. "PCMRS fit" computes the transform alone, like the peers. "PCMRS register_points" also
checks both sets, looks for a mirror image and computes all residuals. Peers that are not installed are named and left
out (`pip install 'pcmrs[compare]'`). All take turns in short rounds, so that changes of the machine's load affect all
alike.

Accuracy: on sets without noise, the largest distance between a mapped point and the true one; on noisy sets, the
largest distance between a mapped point and where the fit with the least sum of squares puts it. Half of the sets are
flat.

    .venv/bin/python benchmarks/registration.py [--points 6] [--sets 100] [--rounds 40] [--json]
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pcmrs.registration import register_batch, register_points
from pcmrs.registration.rigid import fit_rigid
from pcmrs.spatial import Floats

Fit = Callable[[Floats, Floats], tuple[Floats, Floats]]
NOISE = 0.002  # m per axis


def pcmrs_fit(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
    """Return rotation and translation of PCMRS' fit.

    Args:
        fixed: Fixed points, m, (N, 3).
        moving: Moving points, m, (N, 3).
    """
    fit = fit_rigid(fixed, moving)
    return fit.rotation, fit.translation


def pcmrs_register(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
    """Return rotation and translation of PCMRS' registration.

    Args:
        fixed: Fixed points, m, (N, 3).
        moving: Moving points, m, (N, 3).
    """
    fixed_from_moving = register_points(fixed, moving).fixed_from_moving
    return fixed_from_moving.rotation, fixed_from_moving.translation


def scipy_fit() -> Fit:
    def fit(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
        fixed_centroid, moving_centroid = fixed.mean(axis=0), moving.mean(axis=0)
        found, _ = Rotation.align_vectors(fixed - fixed_centroid, moving - moving_centroid)
        rotation = found.as_matrix()
        return rotation, fixed_centroid - rotation @ moving_centroid

    return fit


def surgerycore_fit() -> Fit:
    from sksurgerycore.algorithms.procrustes import orthogonal_procrustes

    def fit(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
        rotation, translation, _ = orthogonal_procrustes(fixed, moving)
        return rotation, translation[:, 0]

    return fit


def simpleitk_fit() -> Fit:
    import SimpleITK as itk  # noqa: N813

    def fit(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
        # In ITK a transform maps from the fixed space: what is called fixed here is its moving.
        found = itk.VersorRigid3DTransform(
            itk.LandmarkBasedTransformInitializer(
                itk.VersorRigid3DTransform(), moving.ravel().tolist(), fixed.ravel().tolist()
            )
        )
        rotation, centre = np.array(found.GetMatrix()).reshape(3, 3), np.array(found.GetCenter())
        return rotation, np.array(found.GetTranslation()) + centre - rotation @ centre

    return fit


def vtk_fit() -> Fit:
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonTransforms import vtkLandmarkTransform

    def points(values: Floats) -> Any:
        made = vtkPoints()
        made.SetDataTypeToDouble()
        for point in values.tolist():
            made.InsertNextPoint(point)
        return made

    def fit(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
        found = vtkLandmarkTransform()
        found.SetSourceLandmarks(points(moving))
        found.SetTargetLandmarks(points(fixed))
        found.SetModeToRigidBody()
        found.Update()
        matrix = np.array(found.GetMatrix().GetData()).reshape(4, 4)
        return matrix[:3, :3], matrix[:3, 3]

    return fit


OWN: dict[str, Fit] = {"PCMRS fit": pcmrs_fit, "PCMRS register_points": pcmrs_register}
PEERS: dict[str, tuple[str, Callable[[], Fit]]] = {
    "SciPy align_vectors": ("scipy", scipy_fit),
    "scikit-surgerycore": ("scikit-surgerycore", surgerycore_fit),
    "SimpleITK": ("simpleitk", simpleitk_fit),
    "VTK": ("vtk", vtk_fit),
}


def installed_peers() -> tuple[dict[str, Fit], dict[str, str]]:
    """Return the peers that can be measured, and the version of each; ``not installed`` if it is missing."""
    fits: dict[str, Fit] = {}
    versions: dict[str, str] = {}
    for name, (package, make) in PEERS.items():
        try:
            fits[name] = make()
            versions[name] = importlib.metadata.version(package)
        except ImportError:
            versions[name] = "not installed"
    return fits, versions


def make_sets(rng: np.random.Generator, sets: int, points: int) -> tuple[Floats, Floats]:
    """Return moving points, and their positions after a rigid motion, m, (sets, points, 3).

    Args:
        rng: Source of randomness.
        sets: Number of sets.
        points: Number of points of a set.
    """
    moving = rng.uniform(-0.1, 0.1, (sets, points, 3))
    moving[::2, :, 2] = 0.0  # flat ones
    moving = moving @ Rotation.random(sets, rng=rng).as_matrix() + rng.uniform(-0.3, 0.3, (sets, 1, 3))
    rotations = Rotation.random(sets, rng=rng).as_matrix()
    return moving, moving @ rotations.swapaxes(1, 2) + rng.uniform(-1.0, 1.0, (sets, 1, 3))


def mapped(fit: Fit, fixed: Floats, moving: Floats) -> Floats:
    """Return the points of every set mapped by its fit, m, (sets, points, 3).

    Args:
        fit: Fit to use.
        fixed: Fixed points, m, (sets, points, 3).
        moving: Moving points, m, (sets, points, 3).
    """
    moved = []
    for target, points in zip(fixed, moving, strict=True):
        rotation, translation = fit(target, points)
        moved.append(points @ rotation.T + translation)
    return np.array(moved)


def farthest(a: Floats, b: Floats) -> float:
    """Return the largest distance between corresponding points, m.

    Args:
        a: Points, m, (..., 3).
        b: Points, m, (..., 3).
    """
    return float(np.linalg.norm(a - b, axis=-1).max())


def accuracy(fits: dict[str, Fit], exact: Floats, noisy: Floats, moving: Floats) -> dict[str, dict[str, float]]:
    """Return the errors of each fit, m.

    Args:
        fits: Fits by name.
        exact: Fixed points without noise, m.
        noisy: Fixed points with noise, m.
        moving: Moving points, m.
    """
    moved = {name: mapped(fit, noisy, moving) for name, fit in fits.items()}
    squares = np.array([np.sum((each - noisy) ** 2, axis=(1, 2)) for each in moved.values()])
    best = np.array(list(moved.values()))[squares.argmin(axis=0), np.arange(len(moving))]
    return {
        name: {"exact_m": farthest(mapped(fit, exact, moving), exact), "from_best_m": farthest(moved[name], best)}
        for name, fit in fits.items()
    }


def own_batch(fixed: Floats, moving: Floats) -> None:
    """Register all sets by one call of PCMRS.

    Args:
        fixed: Fixed points, m, (sets, points, 3).
        moving: Moving points, m, (sets, points, 3).
    """
    register_batch(fixed, moving)


def in_turn(fit: Fit) -> Callable[[Floats, Floats], None]:
    def batch(fixed: Floats, moving: Floats) -> None:
        for target, points in zip(fixed, moving, strict=True):
            fit(target, points)

    return batch


def times_us(batches: dict[str, Callable[[Floats, Floats], None]], noisy: Floats, moving: Floats, rounds: int) -> Any:
    """Return the time per set in the best round, µs, since other load of the machine only adds to it.

    Args:
        batches: Functions by name.
        noisy: Fixed points with noise, m.
        moving: Moving points, m.
        rounds: Number of rounds after the one that warms up.
    """
    spent: dict[str, list[float]] = {name: [] for name in batches}
    for number in range(rounds + 1):  # the first warms up
        for name, batch in batches.items():
            begin = time.perf_counter_ns()
            batch(noisy, moving)
            if number:
                spent[name].append((time.perf_counter_ns() - begin) / 1000.0 / len(moving))
    return {name: min(each) for name, each in spent.items()}


def run(points: int, sets: int, rounds: int, seed: int) -> dict[str, Any]:
    """Measure all libraries in turn.

    Args:
        points: Number of points of a set.
        sets: Number of sets.
        rounds: Number of rounds.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    moving, exact = make_sets(rng, sets, points)
    noisy = exact + rng.normal(scale=NOISE, size=exact.shape)
    peers, versions = installed_peers()
    fits = OWN | peers
    accurate = accuracy(fits, exact, noisy, moving)
    single = times_us({name: in_turn(fit) for name, fit in fits.items()}, noisy, moving, rounds)
    batch = times_us({"PCMRS register_batch": own_batch}, noisy, moving, rounds)["PCMRS register_batch"]
    fastest = min((single[name] for name in peers), default=float("nan"))
    return {
        "points": points,
        "sets": sets,
        "versions": versions,
        "rows": [
            {"name": name, **accurate[name], "single_us": single[name], "times_fastest_peer": single[name] / fastest}
            for name in fits
        ],
        "batch_us_per_set": batch,
        "batch_times_faster_than_fastest_peer": fastest / batch,
    }


def report(results: dict[str, Any]) -> None:
    """Print the results."""
    print(
        f"Python {platform.python_version()}, {platform.machine()}; {results['points']} points, {results['sets']} sets"
    )
    for name, version in results["versions"].items():
        print(f"{name}: {version}")
    print(f"\n{'':<24}{'without noise m':>18}{'from the best m':>18}{'µs per set':>12}{'/ fastest peer':>16}")
    for row in results["rows"]:
        print(
            f"{row['name']:<24}{row['exact_m']:>18.1e}{row['from_best_m']:>18.1e}"
            f"{row['single_us']:>12.1f}{row['times_fastest_peer']:>16.2f}"
        )
    print(
        f"\nPCMRS register_batch: {results['batch_us_per_set']:.2f} µs per set, "
        f"{results['batch_times_faster_than_fastest_peer']:.1f} times as fast as the fastest peer in turn"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=6)
    parser.add_argument("--sets", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    results = run(arguments.points, arguments.sets, arguments.rounds, arguments.seed)
    print(json.dumps(results)) if arguments.json else report(results)


if __name__ == "__main__":
    main()
