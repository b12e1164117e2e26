"""A teleoperator guides the tool near its planned pose, for as long as the clutch is engaged."""

from __future__ import annotations

from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.spatial import Frame
from pcmrs.workflows.alignment import BODIES
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.collision_checks import update_collision_scene
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.following import FIRST_FRAMES, FIRST_TIME
from pcmrs.workflows.guiding import TELL_EVERY, Activity, Guide, Guiding, planned_in_body_ref
from pcmrs.workflows.placement import check_at_present_plan

Run = AnyRun[Cell, PlacementData]

BUS = "bus:"
"""What the sources of those begin with who can send set points."""


def guide_possible(run: Run) -> None:
    """Refuses to guide a tool that is not seen with the body, or from where the arm cannot go to its planned pose."""
    check_at_present_plan(run.data)
    cell = run.cell
    body_ref_from_plan = planned_in_body_ref(cell, run.data)
    update_collision_scene(cell, run.data)
    Guide(cell, cell.frames(run.data).get(Frame.ROBOT_BASE, Frame.BODY_REF) @ body_ref_from_plan)


async def see_tool_and_body(run: Run) -> None:
    """Waits until tool and body have been seen together once more. Raises `RefusalError` where they are not."""
    await run.cell.poses.collect(BODIES, FIRST_FRAMES, timeout=FIRST_TIME)


def engage_possible(run: Run) -> None:
    """Refuses whoever cannot send set points, and to engage where tool or body are hidden.

    Set points come over the bus, and are known by the user in their key.
    """
    if not run.command.source.startswith(BUS):
        text = f"Set points come over the bus, which {run.command.source} does not use: engage by `pcmrs teleop`."
        raise RefusalError("no_teleoperator", text, source=run.command.source)
    for body in BODIES:
        run.cell.poses.newest(body)


def keep_teleoperator(run: Run) -> None:
    """The set points of who asks count from now on, and of nobody else."""
    run.keep(teleoperator=run.command.user)


async def teleoperate(act: Activity) -> None:
    """Moves the tool as the engaged teleoperator asks; otherwise stands, and waits for the clutch.

    Raises:
        RefusalError: See `Guiding`: the robot is held then.
        DeviceError: The robot has ended the stream by itself.
    """
    guiding = Guiding(act)
    with act.cell.teleop.heard_by(guiding.hear):
        while True:
            guiding.tell()
            if guiding.wanted is not None:
                await _while_engaged(act, guiding, guiding.wanted)
            await act.clock.sleep(TELL_EVERY)


async def _while_engaged(act: Activity, guiding: Guiding, user: str) -> None:
    """Sends set points to the robot until this user's clutch is open; ends the stream, in which the arm brakes."""
    clock, period = act.clock, act.cell.settings.teleoperation.period
    guiding.engage(user)
    async with act.cell.robot.servo() as stream:
        now = clock.monotonic()
        while guiding.wanted == user:
            before, now = now, clock.monotonic()
            velocities = guiding.advance(now, max(now - before, period))
            stream.send(guiding.guide.positions, velocities)
            await clock.sleep(period)
    guiding.release()


def register_teleoperation(registry: Registry[Cell, PlacementData]) -> None:
    """Registers the names that blueprints use for these checks, steps and activity."""
    registry.long_check(guide_possible)
    registry.check(engage_possible)
    registry.world_step(see_tool_and_body)
    registry.step(keep_teleoperator)
    registry.activity(teleoperate, moves=True)
