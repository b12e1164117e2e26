"""A cell in simulated time with its processes at hand, for tests."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from pcmrs.settings import read_settings
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs.testing.simulated import CellInSimulatedTime
from pcmrs.workflows.opening import open_workflow
from pcmrs_sim.deterministic.cell import SimulatedCell, simulated_cell

OVERRIDES = ("workflow=ratms", "sim.seed=1", "sim.arm.physics=kinematic")

Play = Callable[[SimulatedCell, CellInSimulatedTime], Awaitable[None]]


def in_cell(play: Play, folder: Path, **options: Any) -> None:
    """Play in a new cell, whose journal is in `folder`, with a client."""

    async def run() -> None:
        settings, workflow = read_settings(overrides=OVERRIDES), open_workflow("ratms")
        async with simulated_cell(settings, workflow, folder / "journal.sqlite", 1, **options) as cell:
            await play(cell, CellInSimulatedTime(cell))

    run_on_simulated_loop(run())


async def connect(client: CellInSimulatedTime) -> None:
    """Connect the robot, and wait until its state is known."""
    await client.accept("robot.connect")
    await client.until(lambda shown: shown.branches["placement"] != "unknown" and not shown.running)
