"""The planning process of a simulated daemon. It takes as long as a window, and plans with the state before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pcmrs.clock import Clock
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.dispatcher import Workflow
from pcmrs.dispatcher.execution import reason_of, refusal
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import Reason
from pcmrs.settings import Settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.planning import PlanningCell, apply_answer, request_of, too_late

Run = AnyRun[Cell, PlacementData]


class SimulatedPlanner:
    """Implementation of `pcmrs.dispatcher.execution.MotionChecker`.

    Args:
        workflow: The opened procedure, with its checks.
        settings: Settings of the daemon.
        clock: Clock in whose time a window lasts.
        window: Opens a window by its name, such as ``plan:placement.approach``, and returns how long it lasts, s.
    """

    def __init__(
        self,
        workflow: Workflow[Cell, PlacementData],
        settings: Settings,
        clock: Clock,
        window: Callable[[str], float],
    ) -> None:
        self._workflow = workflow
        self._settings = settings
        self._clock = clock
        self._window = window
        self._cell: PlanningCell | None = None

    async def check(self, run: Run, checks: Sequence[str], within: float | None = None) -> Reason | None:
        """Ask checks; see `MotionChecker`. In a window of no length nothing changes, so no copy is needed.

        The window of a step's check, which alone has a limit, has the name of the check behind that of the operation.
        """
        name = f"{run.command.branch}.{run.command.operation}"
        duration = self._window(f"plan:{name}" if within is None else f"plan:{name}:{checks[0]}")
        if within is not None and duration > within:
            await self._clock.sleep(within)
            return reason_of(too_late(name, within))
        if not duration:
            return refusal(self._workflow.registry, checks, run)
        if self._cell is None:
            arm = ArmModel(find_arm(self._settings.robot.model))
            self._cell = PlanningCell(
                self._workflow, self._settings.procedure, arm, run.cell.surface, run.cell.mounting
            )
        request = request_of(run, checks)
        answer = self._cell.answer(request)
        await self._clock.sleep(duration)
        return apply_answer(run, request, answer)
