"""Time and memory of the verifier for a million joint states, compared with a plain search.

Each shape runs in a separate process, so that its peak memory is measured separately. The plain search is the obvious
implementation: breadth first over dictionaries, `pcmrs.fsm.close` for every operation that users or devices may
request. It only collects joint states of the same blueprint, and ends after some thousands; the verifier finds all of
them and also checks everything that `pcmrs fsm verify` reports.

    .venv/bin/python benchmarks/verify.py [--plain 3000] [--json]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import platform
import resource
import sys
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from pcmrs.fsm import Blueprint, Denial, close
from pcmrs.fsm.verify import verify

sys.path.append(str(Path(__file__).parents[1]))
from tests.unit.fsm.large_blueprints import entangled, free, promising

SHAPES = {
    "20 free branches of 2 states": lambda: free(20, 2),
    "10 free branches of 4 states": lambda: free(10, 4),
    "10 entangled branches of 4 states": lambda: entangled(10, 4),
    "20 of 2, a promise on what runs": lambda: promising(20),
}
SMALL = 8
"""Number of branches of the blueprint on which both searches must agree first."""


def verified(shape: str) -> dict[str, Any]:
    """Return the results of the verifier for one shape."""
    blueprint = SHAPES[shape]()
    begin = time.perf_counter()
    found = verify(blueprint)
    seconds = time.perf_counter() - begin
    if found.findings:
        raise ValueError(f"{shape}: {found.findings[0].text}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"joint_states": found.joint_states, "seconds": seconds, "peak_mib": peak}


def searched(shape: str, most: int) -> dict[str, Any]:
    """Return the results of the plain search for one shape.

    Args:
        shape: Key of `SHAPES`.
        most: Number of joint states after which it ends.
    """
    blueprint = SHAPES[shape]()
    begin = time.perf_counter()
    states = plain(blueprint, most)
    return {"joint_states": states, "seconds": time.perf_counter() - begin}


def plain(blueprint: Blueprint, most: int) -> int:
    """Search joint states, and return how many were searched.

    Args:
        blueprint: Workflow.
        most: Number of joint states after which it ends.
    """
    start = blueprint.initial()
    known, waiting, done = {tuple(start.values())}, deque([start]), 0
    while waiting and done < most:
        for after in successors(blueprint, waiting.popleft()):
            key = tuple(after.values())
            if key not in known:
                known.add(key)
                waiting.append(after)
        done += 1
    return done


def successors(blueprint: Blueprint, states: dict[str, str]) -> Iterator[dict[str, str]]:
    """Yield the joint states that one command may lead to.

    Args:
        blueprint: Workflow.
        states: State of each branch.
    """
    for name, branch in blueprint.branches.items():
        for operation, spec in branch.operations.items():
            if spec.iio or not branch.valid_in(operation, states[name]):
                continue
            closure = close(blueprint, states, name, operation)
            if not isinstance(closure, Denial):
                for change in (*closure.outcomes.values(), closure.failure, closure.unknown):
                    if change is not None:
                        yield {branch: change.states[branch] for branch in states}


def agree() -> None:
    """Check that both searches find the same number of joint states of small blueprints."""
    for blueprint in (free(SMALL, 2), entangled(SMALL // 2, 4)):
        one, other = plain(blueprint, sys.maxsize), verify(blueprint).joint_states
        if one != other:
            raise ValueError(f"{blueprint.id}: the plain search finds {one} joint states, the verifier {other}.")


def measure(most: int) -> list[dict[str, Any]]:
    """Return the results of all shapes."""
    rows = []
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context, max_tasks_per_child=1) as fresh:
        for shape in SHAPES:
            ours, theirs = fresh.submit(verified, shape).result(), fresh.submit(searched, shape, most).result()
            rate, plain_rate = (each["joint_states"] / each["seconds"] for each in (ours, theirs))
            ratio = rate / plain_rate
            rows.append({"shape": shape, **ours, "per_s": rate, "plain_per_s": plain_rate, "ratio": ratio})
    return rows


def report(rows: list[dict[str, Any]]) -> None:
    """Print the results."""
    print(f"Python {platform.python_version()}, {platform.machine()}; joint states per second")
    print(f"\n{'':<36}{'states':>9}{'s':>7}{'MiB':>7}{'verify/s':>12}{'plain/s':>10}{'ratio':>8}")
    for row in rows:
        print(
            f"{row['shape']:<36}{row['joint_states']:>9}{row['seconds']:>7.1f}{row['peak_mib']:>7.0f}"
            f"{row['per_s']:>12.0f}{row['plain_per_s']:>10.0f}{row['ratio']:>8.0f}"
        )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plain", type=int, default=3000, help="number of joint states of the plain search")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    agree()
    rows = measure(arguments.plain)
    print(json.dumps(rows)) if arguments.json else report(rows)


if __name__ == "__main__":
    main()
