"""A whole cell in one process and in simulated time: a procedure takes seconds, and every run is the same."""

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
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.testing.errors import Unmet
from pcmrs.workflows.opening import open_workflow

if TYPE_CHECKING:
    from pcmrs_sim.deterministic.cell import SimulatedCell

T = TypeVar("T")

USER = "tester"
PATIENCE = 60.0
"""Longest wait, s of the cell."""
POLL_PERIOD = 0.01
"""A condition that is waited for is looked at after each of these, s of the cell."""


class CellInSimulatedTime:
    """A running cell, and a client of it; use `simulated_cell` or `run_simulated`.

    Attributes:
        clock: Of the client's machine.
        scene: Truth and faults of the simulation.
    """

    def __init__(self, cell: SimulatedCell) -> None:
        self.clock = SimulatedClock(asyncio.get_running_loop())
        self.scene: Scene = cell.devices["scene"]
        self._cell = cell
        self._link = cell.network.endpoint(USER)
        self._numbers = itertools.count(1)

    @property
    def snapshot(self) -> Snapshot:
        """The daemon's present state.

        Raises:
            Unmet: The daemon does not run.
        """
        procedure = None if self._cell.daemon is None else self._cell.daemon.procedure
        if procedure is None:
            raise Unmet("The daemon does not run.")
        return procedure.dispatcher.snapshot()

    async def call(self, name: str, **arguments: object) -> Verdict:
        """Ask for an operation and return the verdict.

        Args:
            name: ``branch.operation``.
            arguments: Of the operation.

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
        """Ask for an operation that must be accepted; see `call`.

        Raises:
            Unmet: It was not.
        """
        verdict = await self.call(name, **arguments)
        if verdict.decision != "accepted":
            raise Unmet(f"{name} was {verdict.decision}: {verdict.reason.text if verdict.reason else 'no reason'}")
        return verdict

    async def until(self, condition: Callable[[Snapshot], bool], within: float = PATIENCE) -> Snapshot:
        """Wait for a state.

        Args:
            condition: Holds in the state that is waited for.
            within: s of the cell.

        Raises:
            Unmet: It did not come in time.
        """
        end = self.clock.monotonic() + within
        while not condition(self.snapshot):
            if self.clock.monotonic() > end:
                raise Unmet(f"It did not come within {within:g} s; shown last: {self.snapshot.branches}.")
            await self.clock.sleep(POLL_PERIOD)
        return self.snapshot

    async def crash(self) -> None:
        """End the daemon as SIGKILL does, and start it again on the same journal."""
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
        BlueprintError: The workflow is unsound.
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
    course: Callable[[CellInSimulatedTime], Awaitable[T]],
    workflow: str = "ratms",
    overrides: Sequence[str] = (),
    seed: int = 1,
) -> T:
    """Run a course of events in a new cell in simulated time, and return what it returns; see `simulated_cell`.

    Args:
        course: Called with the cell.
        workflow: Name of an installed workflow, or path of a blueprint.
        overrides: Settings, ``key=value`` each.
        seed: Seed of all simulated errors and delays.

    Raises:
        ConfigurationError: See `simulated_cell`.
        BlueprintError: The workflow is unsound.
    """

    async def run(folder: Path) -> T:
        async with simulated_cell(folder, workflow, overrides, seed) as cell:
            return await course(cell)

    with tempfile.TemporaryDirectory(prefix="pcmrs-") as name:
        loop = SimulatedLoop()
        try:
            return loop.run_until_complete(run(Path(name)))
        finally:
            loop.close()
