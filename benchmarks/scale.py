"""Cost of a request on Dask, and the efficiency of two workers against two processes that are started by hand.

    python benchmarks/scale.py [--requests 2000] [--sessions 40] [--json]

A request without work costs the process of client and scheduler some processor time, and the workers some. The first
limits the number of workers that one scheduler feeds. Processor time hardly depends on what else the machine does;
elapsed times do, so hand and Dask alternate.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
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
    """Return the efficiency of two workers: time by hand over time on Dask, elapsed and of the processors.

    Args:
        sessions: Number of sessions.
        repeats: Number of times that they are run each way, alternately; the least times count.
    """
    half = sessions // 2
    by_hand, on_dask = list[tuple[float, float]](), list[tuple[float, float]]()
    for _ in range(repeats):
        by_hand.append(_timed([_words(half, 1, "1"), _words(half, 1 + half, "1")]))
        on_dask.append(_timed([_words(2 * half, 1, "2")]))
    hand, dask = ([min(each) for each in zip(*times, strict=True)] for times in (by_hand, on_dask))
    return {
        "by hand, s elapsed": hand[0],
        "on Dask, s elapsed": dask[0],
        "by hand, s of processor": hand[1],
        "on Dask, s of processor": dask[1],
        "efficiency, elapsed": hand[0] / dask[0],
        "efficiency, processor": hand[1] / dask[1],
    }


def _words(sessions: int, seed: int, workers: str) -> list[str]:
    words = ["faults", "explore", "--sessions", str(sessions), "--seed", str(seed), "--workers", workers, "--json"]
    return [sys.executable, "-m", "pcmrs.cli", *words]


def _timed(commands: list[list[str]]) -> tuple[float, float]:
    """Run commands at the same time, and return elapsed and processor time, s, of them and their processes."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    processes = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for command in commands]
    for process in processes:
        if process.wait() != 0:
            raise SystemExit(f"{process.args} has failed.")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.monotonic() - started, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
