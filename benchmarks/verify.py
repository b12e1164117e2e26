"""How long the verifier takes for a million joint states, and how much memory, beside a plain search.

Each shape in a process of its own, so that its peak memory is its own. The plain search is what one would write
first: breadth first over dictionaries, `pcmrs.fsm.close` for every operation that users or devices may ask for. It
only collects joint states, of the same blueprint, and is ended after some thousands; the verifier finds all of them
and also checks everything that `pcmrs fsm verify` reports.

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
"""Branches of the blueprint that the plain search and the verifier must agree on first."""


def verified(shape: str) -> dict[str, Any]:
    blueprint = SHAPES[shape]()
    begin = time.perf_counter()
    found = verify(blueprint)
    seconds = time.perf_counter() - begin
    if found.findings:
        raise ValueError(f"{shape}: {found.findings[0].text}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {"joint_states": found.joint_states, "seconds": seconds, "peak_mib": peak}


def searched(shape: str, most: int) -> dict[str, Any]:
    blueprint = SHAPES[shape]()
    begin = time.perf_counter()
    states = plain(blueprint, most)
    return {"joint_states": states, "seconds": time.perf_counter() - begin}


def plain(blueprint: Blueprint, most: int) -> int:
    """Looks at joint states until all, or `most`, have been looked at; returns how many."""
    start = blueprint.initial()
    known, waiting, done = {tuple(start.values())}, deque([start]), 0
    while waiting and done < most:
        for after in ways(blueprint, waiting.popleft()):
            key = tuple(after.values())
            if key not in known:
                known.add(key)
                waiting.append(after)
        done += 1
    return done


def ways(blueprint: Blueprint, states: dict[str, str]) -> Iterator[dict[str, str]]:
    """The joint states that one command may lead to."""
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
    """Both searches know the same number of joint states of something small."""
    for blueprint in (free(SMALL, 2), entangled(SMALL // 2, 4)):
        one, other = plain(blueprint, sys.maxsize), verify(blueprint).joint_states
        if one != other:
            raise ValueError(f"{blueprint.id}: the plain search finds {one} joint states, the verifier {other}.")


def measure(most: int) -> list[dict[str, Any]]:
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
    print(f"Python {platform.python_version()}, {platform.machine()}; joint states per second")
    print(f"\n{'':<36}{'states':>9}{'s':>7}{'MiB':>7}{'verify/s':>12}{'plain/s':>10}{'ratio':>8}")
    for row in rows:
        print(
            f"{row['shape']:<36}{row['joint_states']:>9}{row['seconds']:>7.1f}{row['peak_mib']:>7.0f}"
            f"{row['per_s']:>12.0f}{row['plain_per_s']:>10.0f}{row['ratio']:>8.0f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--plain", type=int, default=3000, help="joint states that the plain search looks at")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    agree()
    rows = measure(arguments.plain)
    print(json.dumps(rows)) if arguments.json else report(rows)


if __name__ == "__main__":
    main()
