"""Checks that take long, as requests that another process answers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np

from pcmrs.devices.poses import FeedContents, PoseFeed
from pcmrs.devices.protocols import LatchingRobot, Pointer
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.dispatcher import Workflow
from pcmrs.dispatcher.execution import reason_of, refusal
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.formats.mesh import Mesh
from pcmrs.fsm import Blueprint
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import Command, Reason
from pcmrs.workflows._collision_checks import update_collision_scene
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings

Run = AnyRun[Cell, PlacementData]

FRAMES = 64
"""Number of frames of each body that are sent: one second at 60 Hz."""

MAX_JOINT_DRIFT = 0.01
"""Largest motion of a joint of an arm at rest while a motion is planned, rad. Beyond it the arm has left the start."""

_NOT_SENT = {
    *("robot", "pointer", "poses", "arm", "clock", "settings", "surface"),
    *("watchers", "name", "stimulator", "emg", "teleop", "beep"),
}
"""Fields that a cell in another process has itself, or lacks. All other fields are sent."""
_SENT = tuple(field.name for field in fields(Cell) if field.init and field.name not in _NOT_SENT)


@dataclass(frozen=True, slots=True)
class PlanningSettings:
    """Settings of a process that plans for a cell.

    Attributes:
        workflow: Name of the workflow, or path of its blueprint.
        blueprint: Its blueprint as read and verified by the daemon, so that both run the same one.
        procedure: Settings of the procedure.
        arm: Name of the arm, or path of its URDF.
        surface: Surface of the body as read by the daemon, so that plans and the guard of motions use the same surface.
        mounting: Calibrated poses as read by the daemon, for the same reason: their files may have changed since.
    """

    workflow: str
    blueprint: Blueprint
    procedure: ProcedureSettings
    arm: str
    surface: Mesh | None
    mounting: Mounting


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Everything that checks of one operation may read.

    Attributes:
        command: Command of the operation.
        checks: Registered names of the checks.
        payload: Decoded arguments.
        states: State of every branch.
        data: Data of the procedure.
        cell: Fields of the cell by name.
        seen: Recent tracked poses.
        prepared: Question of a step to its check; None before the steps.
        latched: True if Stop is latched.
        monotonic: Monotonic time of the request, s of the cell.
        wall: Wall time of the request, Unix seconds.
    """

    command: Command
    checks: tuple[str, ...]
    payload: Any
    states: dict[str, str]
    data: PlacementData
    cell: dict[str, Any]
    seen: FeedContents
    prepared: Any
    latched: bool
    monotonic: float
    wall: float


@dataclass(frozen=True, slots=True)
class PlanAnswer:
    """Result of checks of one operation.

    Attributes:
        refused: First refusal; None if all checks pass.
        prepared: Value that the checks prepare for the steps.
        result: Values for the result of the operation.
        undecided: Texts of questions that cannot be decided yet.
    """

    refused: Reason | None
    prepared: Any
    result: dict[str, Any]
    undecided: list[str]


def request_of(run: Run, checks: Sequence[str]) -> PlanRequest:
    """Return the request for checks of a run with the present knowledge.

    Args:
        run: Present operation.
        checks: Registered names of the checks.
    """
    cell = run.cell
    return PlanRequest(
        command=run.command,
        checks=tuple(checks),
        payload=run.payload,
        states=dict(run.states),
        data=run.data,
        cell={name: getattr(cell, name) for name in _SENT},
        seen=cell.poses.seen_lately(FRAMES),
        prepared=run.prepared,
        latched=run.latched,
        monotonic=cell.clock.monotonic(),
        wall=cell.clock.wall(),
    )


def too_late(name: str, limit: float) -> RefusalError:
    """Return the refusal for a planner that has not answered in time.

    Args:
        name: Branch and operation.
        limit: Limit of the wait, s.
    """
    text = f"{name} was not planned within {limit:g} s: ask again; check the load of the machine."
    return RefusalError("planner_late", text, limit=limit)


def apply_answer(run: Run, request: PlanRequest, answer: PlanAnswer) -> Reason | None:
    """Store the results of remote checks in a run, and return the first refusal, or None.

    Args:
        run: Present operation.
        request: Request that was answered.
        answer: Answer of the other process.
    """
    if answer.refused is None:
        try:
            _check_stood_still(run, request)
        except RefusalError as error:
            return reason_of(error)
    run.prepared, run.undecided = answer.prepared, answer.undecided
    run.result |= answer.result
    # The checks have placed the zones of the planner's cell, but the guard of the motion uses those of this cell.
    update_collision_scene(run.cell, run.data)
    return answer.refused


def _check_stood_still(run: Run, request: PlanRequest) -> None:
    """Refuse a motion that was planned for an arm at rest that has moved since. Raises `RefusalError`."""
    before = request.cell["joints"]
    if run.motion == "none" or before is None or before.moving:  # a step plans again for an arm that was moving
        return
    moved = float(np.abs(run.cell.posture() - np.array(before.positions)).max())
    if moved > MAX_JOINT_DRIFT:
        text = (
            f"The arm has moved by {np.degrees(moved):.2f}° while its motion was planned, the limit is "
            f"{np.degrees(MAX_JOINT_DRIFT):.2f}°: send the command again when it stands still."
        )
        raise RefusalError("moved_while_planning", text, moved=moved, limit=MAX_JOINT_DRIFT)


class PlanningCell:
    """Cell that runs the checks of one workflow in a process without devices.

    Args:
        workflow: Workflow with the checks.
        settings: Settings of the procedure.
        arm: Model of the cell's arm.
        surface: Surface of the body; None if none is configured.
        mounting: Calibrated poses of tool and pointer.
    """

    def __init__(
        self,
        workflow: Workflow[Cell, PlacementData],
        settings: ProcedureSettings,
        arm: ArmModel,
        surface: Mesh | None,
        mounting: Mounting,
    ) -> None:
        self._workflow = workflow
        self._clock = _FrozenClock()
        self._cell = Cell(
            robot=cast(LatchingRobot, None),
            pointer=cast(Pointer, None),
            poses=PoseFeed(self._clock, settings.max_pose_age),
            arm=arm,
            clock=self._clock,
            settings=settings,
            surface=surface,
            calibrated=mounting,
        )

    def answer(self, request: PlanRequest) -> PlanAnswer:
        """Run the checks of a request with the time and the knowledge of the request."""
        command, cell = request.command, self._cell
        self._clock.now, self._clock.today = request.monotonic, request.wall
        for name, value in request.cell.items():
            setattr(cell, name, value)
        cell.poses.show(request.seen)
        spec = self._workflow.blueprint.branches[command.branch].operations[command.operation]
        run = AnyRun(
            command,
            request.payload,
            request.states,
            cell,
            self._clock,
            request.data,
            _ignore_progress,
            spec.motion,
            request.latched,
            prepared=request.prepared,
        )
        refused = refusal(self._workflow.registry, request.checks, run)
        return PlanAnswer(refused, run.prepared, run.result, run.undecided)


class _FrozenClock:
    """A clock that shows the time of a request. Checks cannot wait."""

    def __init__(self) -> None:
        self.now = self.today = 0.0

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return self.today

    async def sleep(self, seconds: float) -> None:
        raise PcmrsError(f"A check waits for {seconds:g} s: let a step do so.")

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        raise PcmrsError(f"A check waits for up to {seconds:g} s: let a step do so.")


def _ignore_progress(_fraction: float) -> None:
    pass
