"""A whole cell in one process and in simulated time: a procedure takes seconds, and runs are reproducible."""

from __future__ import annotations

import asyncio
import itertools
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from pcmrs.devices.protocols import Scene
from pcmrs.errors import ConfigurationError
from pcmrs.messages import Command, Snapshot, Verdict
from pcmrs.settings import read_settings
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.testing.detector import ScriptedDetector
from pcmrs.testing.errors import Unmet
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs.workflows.opening import open_workflow

if TYPE_CHECKING:
    from pcmrs_sim.deterministic.cell import SimulatedCell

__all__ = ["CellInSimulatedTime", "run_simulated", "simulated_cell"]

T = TypeVar("T")

USER = "tester"
"""Name of the client's user."""
PATIENCE = 60.0
"""Longest wait, s of the cell."""
POLL_PERIOD = 0.01
"""Time between two checks of an awaited condition, s of the cell."""


class CellInSimulatedTime:
    """A running cell, and a client of it; use `simulated_cell` or `run_simulated`.

    Attributes:
        clock: Clock of the client's machine.
        scene: Ground truth and faults of the simulation.
    """

    def __init__(self, cell: SimulatedCell) -> None:
        self.clock = SimulatedClock(asyncio.get_running_loop())
        self.scene: Scene = cell.devices["scene"]
        self._cell = cell
        self._link = cell.network.endpoint(USER)
        self._numbers = itertools.count(1)

    @property
    def snapshot(self) -> Snapshot:
        """Present state of the daemon.

        Raises:
            Unmet: The daemon does not run.
        """
        procedure = None if self._cell.daemon is None else self._cell.daemon.procedure
        if procedure is None:
            raise Unmet("The daemon does not run.")
        return procedure.dispatcher.snapshot()

    async def call(self, name: str, **arguments: object) -> Verdict:
        """Send a command and return its verdict.

        Args:
            name: Name of the operation, ``branch.operation``.
            **arguments: Arguments of the operation.

        Raises:
            UnknownOutcomeError: No verdict came within `PATIENCE`.
        """
        branch, _, operation = name.partition(".")
        if name in self.snapshot.release:
            arguments = {"stop": self.snapshot.stop.number} | arguments
        command = Command(
            id=f"{USER}-{next(self._numbers)}",
            branch=branch,
            operation=operation,
            source=f"bus:{USER}",
            arguments=arguments,
            sent=self.clock.wall(),
        )
        return await self._link.request(f"cmd/{USER}/{branch}/{operation}", command, Verdict, PATIENCE)

    async def accept(self, name: str, **arguments: object) -> Verdict:
        """Send a command that must be accepted, and return its verdict; see `call`.

        Args:
            name: Name of the operation, ``branch.operation``.
            **arguments: Arguments of the operation.

        Raises:
            Unmet: The command was not accepted.
        """
        verdict = await self.call(name, **arguments)
        if verdict.decision != "accepted":
            raise Unmet(f"{name} was {verdict.decision}: {verdict.reason.text if verdict.reason else 'no reason'}")
        return verdict

    async def until(self, condition: Callable[[Snapshot], bool], within: float = PATIENCE) -> Snapshot:
        """Wait for a state that fulfils a condition, and return it.

        Args:
            condition: Returns True for a state that fulfils it.
            within: Longest wait, s of the cell.

        Raises:
            Unmet: No state fulfilled it in time.
        """
        end = self.clock.monotonic() + within
        while not condition(self.snapshot):
            if self.clock.monotonic() > end:
                raise Unmet(f"The state did not come within {within:g} s; shown last: {self.snapshot.branches}.")
            await self.clock.sleep(POLL_PERIOD)
        return self.snapshot

    def detector(self, source: str = "camera", rate_hz: float = 10.0) -> ScriptedDetector:
        """Return a detector of scene events whose user is ``tester``; run it as a task.

        Args:
            source: Name of the source in the cell's table ``scene_events.sources``.
            rate_hz: Rate of its frames, Hz.
        """
        return ScriptedDetector(self._link.publish, self.clock, source, USER, rate_hz)

    async def crash(self) -> None:
        """End the daemon like SIGKILL does, and restart it with the same journal."""
        await self._cell.crash_daemon()
        await self._cell.start_daemon()


@asynccontextmanager
async def simulated_cell(
    folder: Path, workflow: str = "ratms", overrides: Sequence[str] = (), seed: int = 1
) -> AsyncIterator[CellInSimulatedTime]:
    """Open a cell in the simulated time of the running loop, which must be a `SimulatedLoop`.

    Args:
        folder: Folder of the journal. It must exist.
        workflow: Name of an installed workflow, or path of a blueprint.
        overrides: Settings, ``key=value`` each.
        seed: Seed of all simulated errors and delays.

    Raises:
        ConfigurationError: The distribution pcmrs-sim is not installed, there is no such workflow, or a setting cannot
            be used.
        BlueprintError: The blueprint of the workflow breaks a rule.
    """
    try:
        from pcmrs_sim.deterministic.cell import simulated_cell as open_simulated
    except ModuleNotFoundError as error:
        text = f"A cell in simulated time needs {error.name}: install the distribution pcmrs-sim (docs/supply.md)."
        raise ConfigurationError(text, package=error.name) from None
    settings = read_settings(overrides=(f"workflow={workflow}", f"sim.seed={seed}", *overrides))
    async with open_simulated(settings, open_workflow(workflow), folder / "journal.sqlite", seed) as cell:
        yield CellInSimulatedTime(cell)


def run_simulated(
    scenario: Callable[[CellInSimulatedTime], Awaitable[T]],
    workflow: str = "ratms",
    overrides: Sequence[str] = (),
    seed: int = 1,
) -> T:
    """Run a scenario in a new cell in simulated time, and return its result; see `simulated_cell`.

    Args:
        scenario: Called with the cell.
        workflow: Name of an installed workflow, or path of a blueprint.
        overrides: Settings, ``key=value`` each.
        seed: Seed of all simulated errors and delays.

    Raises:
        ConfigurationError: See `simulated_cell`.
        BlueprintError: The blueprint of the workflow breaks a rule.
    """

    async def run(folder: Path) -> T:
        async with simulated_cell(folder, workflow, overrides, seed) as cell:
            return await scenario(cell)

    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name:
        return run_on_simulated_loop(run(Path(name)))
