"""Cost of a request on Dask, and the efficiency of two workers against two processes that are started by hand.

    python benchmarks/scale.py [--requests 2000] [--sessions 40] [--repeats 3] [--json]

A request without work costs the process of client and scheduler processor time, which limits the number of workers
that one scheduler feeds. Elapsed times depend on what else the machine does, so hand and Dask alternate, and the least
time of each counts.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from typing import Any

from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment.monte_carlo import NoiseUsed, TouchesTask, judge_touches
from pcmrs_lab.experiment.published import published
from pcmrs_lab.scale.tasks import Workers, run_tasks

WORKFLOW = "ratms"
FIRST = 50
"""Requests before the measurement: the workers' processes import their modules meanwhile."""
NO_NOISE = NoiseUsed(
    planning_bias_mm=0.0, noise_mm=0.0, sigma_mm=1.0, residual_limit_mm=1.0, tre_limit_mm=1.0, false_alarm=0.01
)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requests", type=int, default=2000, help="requests without work")
    parser.add_argument("--sessions", type=int, default=40, help="simulated sessions, half of them by each process")
    parser.add_argument("--repeats", type=int, default=3, help="number of times that the sessions are run each way")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    found: dict[str, Any] = {"load": os.getloadavg()[0], "cores": os.cpu_count()}
    found |= request_cost(options.requests)
    if options.sessions:
        found |= efficiency(options.sessions, options.repeats)
    print(json.dumps(found) if options.json else "\n".join(f"{name}: {value:.4g}" for name, value in found.items()))


def request_cost(requests: int) -> dict[str, float]:
    """Return processor time of client and scheduler, and elapsed time, for one request without work on two workers.

    Args:
        requests: Number of requests.
    """
    plan, row = read_plan(example_plan(WORKFLOW)), published(WORKFLOW).failures[0]
    tasks = (TouchesTask(row, plan, NO_NOISE, 1, block, 0) for block in range(FIRST + requests))
    running = run_tasks(judge_touches, tasks, Workers(2), 1)
    for _ in range(FIRST):
        next(running)
    own, elapsed = time.process_time(), time.monotonic()
    for _ in range(requests):
        next(running)
    own, elapsed = time.process_time() - own, time.monotonic() - elapsed
    running.close()
    return {
        "client and scheduler, ms per request": 1e3 * own / requests,
        "elapsed, ms per request": 1e3 * elapsed / requests,
    }


def efficiency(sessions: int, repeats: int) -> dict[str, float]:
    """Return the efficiency of two workers: elapsed time by hand over that on Dask, with the start of its scheduler.

    Args:
        sessions: Number of sessions.
        repeats: Number of times that they are run each way, alternately; the least times count.
    """
    half = sessions // 2
    by_hand, on_dask = list[float](), list[float]()
    for _ in range(repeats):
        by_hand.append(_timed([_words(half, 1, "1"), _words(half, 1 + half, "1")]))
        on_dask.append(_timed([_words(2 * half, 1, "2")]))
    hand, dask = min(by_hand), min(on_dask)
    return {"by hand, s": hand, "on Dask, s": dask, "efficiency": hand / dask}


def _words(sessions: int, seed: int, workers: str) -> list[str]:
    words = ["faults", "explore", "--sessions", str(sessions), "--seed", str(seed), "--workers", workers, "--json"]
    return [sys.executable, "-m", "pcmrs.cli", *words]


def _timed(commands: list[list[str]]) -> float:
    """Run commands at the same time, and return how long they took, s."""
    started = time.monotonic()
    processes = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in commands]
    for process in processes:
        if process.wait() != 0:
            raise SystemExit(f"{process.args!r} has failed.")
    return time.monotonic() - started


if __name__ == "__main__":
    main()
