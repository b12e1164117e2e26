"""Tasks that draw numbers, and that report where they run."""

from __future__ import annotations

import os
import time
from pathlib import Path
from uuid import uuid4

import msgspec
import numpy as np

from pcmrs.errors import GeometryError
from pcmrs_sim.deterministic.entropy import seeded_entropy


class DrawTask(msgspec.Struct, frozen=True):
    """Numbers to draw.

    Attributes:
        seed: Seed.
        folder: Folder of the report, and of a file ``go`` that every task waits for.
    """

    seed: int
    folder: str


class Drawn(msgspec.Struct, frozen=True):
    """Drawn numbers; the first is no number of JSON."""

    endless: float
    numbers: list[float]
    identifier: str


class Started(msgspec.Struct, frozen=True):
    """Report of a task that has started."""

    seed: int
    process: int
    worker: int


def draw(tasks: list[DrawTask]) -> list[Drawn]:
    return [_draw(task) for task in tasks]


def fail(tasks: list[DrawTask]) -> list[Drawn]:
    raise GeometryError(f"Seed {tasks[0].seed} has no numbers.")


def started(folder: Path) -> list[Started]:
    """Returns the tasks that have started, in order, and again if they have been repeated."""
    report = folder / "started"
    return (
        [msgspec.json.decode(line, type=Started) for line in report.read_bytes().splitlines()]
        if report.exists()
        else []
    )


def _draw(task: DrawTask) -> Drawn:
    folder = Path(task.folder)
    line = msgspec.json.encode(Started(task.seed, os.getpid(), os.getppid()))
    with (folder / "started").open("ab", buffering=0) as report:
        report.write(line + b"\n")
    with seeded_entropy(task.seed):
        while not (folder / "go").exists():
            time.sleep(0.01)
        return Drawn(float("inf"), np.random.default_rng(task.seed).normal(size=3).tolist(), uuid4().hex)
