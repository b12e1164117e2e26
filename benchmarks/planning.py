"""Time from the question of a correction to its plan: the round trip to the planning process, and the plan alone.

Run: ``python benchmarks/planning.py [TRIPS]``. The cell is that of ``ratms`` with the head phantom, simulated, with the
tool at the standoff. Each correction is as long as the longest plausible one, in a random direction.
"""

from __future__ import annotations

import asyncio
import os
import sys
import time
from pathlib import Path

import numpy as np

from pcmrs.dispatcher.execution import refusal
from pcmrs.simulated_time.loop import SimulatedLoop

sys.path.append(str(Path(__file__).parents[1]))
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.test_planning_process import correction_of, on_the_machine, planning
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

TRIPS = 200
FIRST_TRIPS = 20
"""Number of round trips before those that count: the first ones place the zones."""
CHECKS = ["correction_possible"]
BODY = {"body": {"surface": "head_phantom.ply"}}


async def measure(bench: WorkflowBench, trips: int) -> None:
    """Measure and print.

    Args:
        bench: Cell with the tool at the standoff.
        trips: Number of round trips.
    """
    rng, length = np.random.default_rng(1), bench.cell.settings.placement.correction_limit_mm * 1e-3
    registry = shipped_workflow("ratms").registry
    there, alone = [], []
    async with planning(bench) as (planner, _):
        for _ in range(FIRST_TRIPS + trips):
            shift = rng.normal(size=3)
            shift *= length / np.linalg.norm(shift)
            run = correction_of(bench, shift)
            begin = time.perf_counter()
            refused = await planner.check(run, CHECKS)
            there.append((time.perf_counter() - begin) * 1e3)
            run = correction_of(bench, shift)
            begin = time.perf_counter()
            refused = refused or refusal(registry, CHECKS, run)
            alone.append((time.perf_counter() - begin) * 1e3)
            if refused is not None:
                raise SystemExit(refused.text)
    print(f"{os.cpu_count()} processors, {trips} corrections of {length * 1e3:g} mm")
    for name, times in (("round trip", there), ("the plan alone", alone)):
        p50, p99, most = np.percentile(times[FIRST_TRIPS:], (50, 99, 100))
        print(f"{name:16s} p50 {p50:6.1f} ms   p99 {p99:6.1f} ms   max {most:6.1f} ms")


async def main(trips: int) -> None:
    """Bring the tool to the standoff, and measure there."""
    async with open_bench(BODY) as bench:
        await bench.to_standoff()
        on_the_machine(measure(bench, trips))


if __name__ == "__main__":
    with asyncio.Runner(loop_factory=SimulatedLoop) as runner:
        runner.run(main(int(sys.argv[1]) if len(sys.argv) > 1 else TRIPS))
