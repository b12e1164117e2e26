"""Inverse kinematics: success, accuracy and time, compared with pin-pink, mink, ikpy and pytracik in one run.

Random targets are reachable, made by forward kinematics from postures within the limits, each with a random start
posture. Small steps are at most 3 mm and 0.3 deg from the start posture; a few of them lead out of the joint limits or
of the workspace, so that no solver reaches them: the failures of PCMRS are counted by their reasons. A target counts as
reached within 0.01 mm and 0.01 mrad and within the joint limits. PCMRS answers the random targets by `inverse` (in
closed form, or damped least squares with restarts for an arm without one), the small steps by `track`. The peers get
one start each, as their users give them: pink and mink iterate to 1e-10 or 200 steps, ikpy and pytracik stop by
themselves. None of the peers chooses between postures, and only pytracik retries from another start.

All take turns on the same targets, so that changes of the machine's load affect all alike; PCMRS answers `--targets`
more of them alone, for its rate of success. Peers that are not installed are named and left out (`pip install
'pcmrs[compare]'`).

    .venv/bin/python benchmarks/kinematics.py [--arms iiwa14 panda ur5] [--targets 10000] [--shared 100] [--json]
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import os
import platform
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Floats, Transform, distance, rotation_angle

Solve = Callable[[Transform, Floats], Floats | None]
Problem = tuple[Transform, Floats]
REACHED = 1e-5  # m and rad
STEPS = 200
TOLERANCE = 1e-10


def own(arm: ArmModel, solve: Callable[[ArmModel, Transform, Floats], Floats], reasons: Counter[str]) -> Solve:
    """Return a solver of PCMRS.

    Args:
        arm: Model of the arm.
        solve: Function of PCMRS.
        reasons: Receives the reason of each failure, or its code.
    """

    def answer(target: Transform, seed: Floats) -> Floats | None:
        try:
            return solve(arm, target, seed)
        except UnreachableError as error:
            reasons[error.fields.get("reason", error.code)] += 1
            return None

    return answer


def pink_solver(_arm: ArmModel, file: Path) -> Solve:
    """Return a solver of pin-pink."""
    import pinocchio
    from pink import Configuration, solve_ik
    from pink.tasks import FrameTask

    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    task = FrameTask("flange", position_cost=1.0, orientation_cost=1.0, lm_damping=1e-3)

    def solve(target: Transform, seed: Floats) -> Floats | None:
        configuration = Configuration(model, data, seed)
        task.set_target(pinocchio.SE3(target.rotation, target.translation))
        for _ in range(STEPS):
            if np.linalg.norm(task.compute_error(configuration)) < TOLERANCE:
                break
            velocity = solve_ik(configuration, [task], 1.0, solver="daqp", safety_break=False)
            configuration.integrate_inplace(velocity, 1.0)
        return np.asarray(configuration.q)

    return solve


def mink_solver(arm: ArmModel, _file: Path) -> Solve:
    """Return a solver of mink."""
    import mink
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf(arm.facts))
    configuration = mink.Configuration(model)
    task = mink.FrameTask("flange", "site", position_cost=1.0, orientation_cost=1.0, lm_damping=1e-3)

    def solve(target: Transform, seed: Floats) -> Floats | None:
        configuration.update(seed)
        task.set_target(mink.SE3.from_matrix(target.matrix))
        for _ in range(STEPS):
            if np.linalg.norm(task.compute_error(configuration)) < TOLERANCE:
                break
            configuration.integrate_inplace(mink.solve_ik(configuration, [task], 1.0, solver="daqp"), 1.0)
        return np.array(configuration.q)

    return solve


def ikpy_solver(arm: ArmModel, file: Path) -> Solve:
    """Return a solver of ikpy.

    Args:
        arm: Model of the arm.
        file: URDF file of the arm.
    """
    from ikpy.chain import Chain

    mask = [False, *[True] * arm.joints, False]
    chain = Chain.from_urdf_file(str(file), base_elements=["base"], active_links_mask=mask)

    def solve(target: Transform, seed: Floats) -> Floats | None:
        start = [0.0, *seed.tolist(), 0.0]
        return np.asarray(chain.inverse_kinematics_frame(target.matrix, start, orientation_mode="all")[1:-1])

    return solve


def pytracik_solver(_arm: ArmModel, file: Path) -> Solve:
    """Return a solver of pytracik."""
    from trac_ik import TracIK

    solver = TracIK("base", "flange", str(file), timeout=0.05, epsilon=1e-9)

    def solve(target: Transform, seed: Floats) -> Floats | None:
        found = solver.ik(target.translation, target.rotation, seed)
        return None if found is None else np.asarray(found)

    return solve


PEERS = {"pin-pink": pink_solver, "mink": mink_solver, "ikpy": ikpy_solver, "pytracik": pytracik_solver}


def random_targets(arm: ArmModel, count: int, seed: int) -> list[Problem]:
    """Return random reachable targets, each with a start posture.

    Args:
        arm: Model of the arm.
        count: Number of targets.
        seed: Seed of the random numbers.
    """
    pairs = np.random.default_rng(seed).uniform(arm.lower, arm.upper, (count, 2, arm.joints))
    return [(arm.forward(known), start) for known, start in pairs]


def small_steps(arm: ArmModel, count: int, seed: int) -> list[Problem]:
    """Return targets near their start posture.

    Args:
        arm: Model of the arm.
        count: Number of targets.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    inset = 0.1 * (arm.upper - arm.lower)
    starts = rng.uniform(arm.lower + inset, arm.upper - inset, (count, arm.joints))
    steps = rng.uniform(-1.0, 1.0, (count, 6)) / np.sqrt(3.0)
    return [
        (arm.forward(start) @ Transform.from_rotvec(0.003 * step[:3], np.radians(0.3) * step[3:]), start)
        for start, step in zip(starts, steps, strict=True)
    ]


def peers(arm: ArmModel, file: Path) -> dict[str, Solve]:
    """Return the solvers of the installed peers.

    Args:
        arm: Model of the arm.
        file: URDF file of the arm.
    """
    found: dict[str, Solve] = {}
    for name, make in PEERS.items():
        with contextlib.suppress(ImportError):
            found[name] = make(arm, file)
    return found


def measure(arm: ArmModel, solvers: dict[str, Solve], problems: Iterable[Problem]) -> dict[str, dict[str, float]]:
    """Return success, error and time of each solver; times include targets that were not reached.

    Args:
        arm: Model of the arm.
        solvers: Solvers by name.
        problems: Targets with their start postures.
    """
    times: dict[str, list[float]] = {name: [] for name in solvers}
    errors: dict[str, list[float]] = {name: [] for name in solvers}
    for target, seed in problems:
        for name, solve in solvers.items():
            begin = time.perf_counter()
            q = solve(target, seed)
            times[name].append(time.perf_counter() - begin)
            errors[name].append(np.inf if q is None else error_of(arm, q, target))
    return {name: summary(np.array(times[name]), np.array(errors[name])) for name in solvers}


def error_of(arm: ArmModel, q: Floats, target: Transform) -> float:
    """Return the distance from the target, m; infinite if it is not reached or a limit is exceeded.

    Args:
        arm: Model of the arm.
        q: Joint positions, rad.
        target: Target pose of the flange.
    """
    if np.any(q < arm.lower - 1e-9) or np.any(q > arm.upper + 1e-9):
        return np.inf
    reached = arm.forward(q)
    away = distance(reached, target)
    return away if max(away, rotation_angle(reached, target)) <= REACHED else np.inf


def summary(times: Floats, errors: Floats) -> dict[str, float]:
    """Return statistics of one solver.

    Args:
        times: Times, s.
        errors: Distances from the targets, m.
    """
    reached = np.isfinite(errors)
    return {
        "count": len(times),
        "success_percent": 100.0 * float(reached.mean()),
        "error_m": float(errors[reached].max(initial=0.0)),
        "median_ms": 1e3 * float(np.median(times)),
        "p99_ms": 1e3 * float(np.percentile(times, 99)),
    }


def show(title: str, rows: dict[str, dict[str, float]]) -> None:
    """Print one table.

    Args:
        title: Title of the table.
        rows: Statistics by solver; the first one is PCMRS.
    """
    print(f"  {title}\n    {'':24} {'count':>6} {'success':>9} {'error':>9} {'median':>9} {'p99':>9} {'ratio':>7}")
    first = next(iter(rows.values()))["median_ms"]
    for name, row in rows.items():
        print(
            f"    {name:24} {row['count']:6.0f} {row['success_percent']:7.2f} % {row['error_m']:7.0e} m "
            f"{row['median_ms']:6.3f} ms {row['p99_ms']:6.2f} ms {row['median_ms'] / first:7.1f}"
        )


def compare(name: str, targets: int, shared: int) -> dict[str, Any]:
    """Return the results for one arm.

    Args:
        name: Name of the arm.
        targets: Number of targets that PCMRS solves alone.
        shared: Number of targets that all solve in turn.
    """
    arm = ArmModel(find_arm(name))
    reasons: Counter[str] = Counter()
    by_inverse = {"PCMRS inverse": own(arm, inverse, reasons)}
    by_track = {"PCMRS track": own(arm, track, reasons)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"{name}.urdf"
        file.write_text(urdf(arm.facts))
        others = peers(arm, file)
        results = {
            "random targets": measure(arm, by_inverse | others, random_targets(arm, shared, 1)),
            "small steps": measure(arm, by_track | others, small_steps(arm, shared, 2)),
            "random targets, alone": measure(arm, by_inverse, random_targets(arm, targets, 3)),
        }
        reasons.clear()
        results["small steps, alone"] = measure(arm, by_track, small_steps(arm, targets, 4))
    return {"problems": results, "failed small steps, alone": dict(reasons)}


def version_of(name: str) -> str:
    """Return the installed version of a package."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed, left out"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", nargs="+", default=["iiwa14", "panda", "ur5"])
    parser.add_argument("--targets", type=int, default=10_000, help="number of targets that PCMRS solves alone")
    parser.add_argument("--shared", type=int, default=100, help="number of targets that all solve in turn")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")  # warnings of the peers about exceeded limits
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    versions = {name: version_of(name) for name in PEERS}
    results = {name: compare(name, arguments.targets, arguments.shared) for name in arguments.arms}
    if arguments.json:
        print(json.dumps({"machine": machine, "versions": versions, "arms": results}))
        return
    print(machine, *(f"{name}: {version}" for name, version in versions.items()), sep="\n")
    for name, result in results.items():
        print(f"{name}; ratio of the medians to that of PCMRS")
        for title, rows in result["problems"].items():
            show(title, rows)
        failed = ", ".join(f"{count} {reason}" for reason, count in result["failed small steps, alone"].items())
        print(f"  failed small steps, alone: {failed or 'none'}")


if __name__ == "__main__":
    main()
