"""The example with timers, on a simulated cell in simulated time."""

from __future__ import annotations

from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs.testing.simulated import CellInSimulatedTime, run_simulated
from tests import ROOT

WORKFLOW = str(ROOT / "examples" / "timed_pulses" / "timed_pulses.toml")
QUICK = ("sim.arm.physics=kinematic",)


async def to_registered(cell: CellInSimulatedTime) -> None:
    await cell.accept("robot.connect")
    await cell.until(lambda shown: shown.branches["placement"] != "unknown" and not shown.running)
    await cell.accept("registration.plan_landmarks", **landmarks())
    await cell.accept("registration.digitize_all")
    await cell.accept("registration.register")
    await cell.accept("toolplan.plan", **tool_pose())


async def place(cell: CellInSimulatedTime) -> None:
    await cell.accept("placement.approach")
    await cell.accept("placement.confirm")


async def refused(cell: CellInSimulatedTime, name: str) -> str:
    verdict = await cell.call(name)
    assert verdict.decision == "rejected"
    assert verdict.reason is not None
    return verdict.reason.code


def test_a_tool_that_is_left_alone_is_held_and_disarmed() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_registered(cell)
        await place(cell)
        await cell.accept("pulses.arm")
        await cell.clock.sleep(29.0)
        assert cell.snapshot.branches["placement"] == "placed"
        shown = await cell.until(lambda shown: shown.branches["placement"] == "held", within=2.0)
        assert (shown.branches["pulses"], shown.latched) == ("disarmed", False)
        assert await refused(cell, "placement.approach") == "invalid_in_state"
        await cell.accept("placement.back_off")
        assert cell.snapshot.branches["placement"] in ("standoff", "retracted")

    run_simulated(course, WORKFLOW, (*QUICK, "procedure.limits.idle_s=30"))


def test_pulses_wait_for_the_rest_and_for_the_pause() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_registered(cell)
        await place(cell)
        await cell.accept("pulses.arm")
        assert await refused(cell, "pulses.give") == "invalid_in_state"
        await cell.until(lambda shown: shown.branches["pulses"] == "ready", within=11.0)
        for _ in range(2):
            given = cell.clock.monotonic()
            await cell.accept("pulses.give")
            assert await refused(cell, "pulses.give") == "invalid_in_state"
            await cell.until(lambda shown: shown.branches["pulses"] == "ready", within=11.0)
        assert cell.clock.monotonic() - given >= 10.0, "the train has ended: the pause follows, not the rest"

    limits = ("procedure.limits.pulses_in_train=2", "procedure.limits.train_pause_s=10")
    run_simulated(course, WORKFLOW, (*QUICK, *limits))


def test_a_registration_is_validated_again_after_its_time() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_registered(cell)
        await cell.clock.sleep(31.0)
        assert cell.snapshot.branches["validity"] == "due"
        assert await refused(cell, "placement.approach") == "validation_due"
        await cell.accept("validity.validate", index=0)
        assert cell.snapshot.branches["validity"] == "valid"
        await cell.clock.sleep(20.0)
        await cell.accept("placement.approach")

    run_simulated(course, WORKFLOW, (*QUICK, "procedure.limits.validation_s=30"))


def test_a_registration_is_validated_again_after_placements() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_registered(cell)
        for validity in ("valid", "due"):
            await place(cell)
            await cell.until(lambda shown: not shown.running)
            assert cell.snapshot.branches["validity"] == validity
            assert cell.snapshot.branches["placement"] == "placed"
            await cell.accept("placement.home")
        assert await refused(cell, "placement.approach") == "validation_due"

    run_simulated(course, WORKFLOW, (*QUICK, "procedure.limits.placements=2"))


def test_a_restart_in_the_middle_begins_with_no_timers() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_registered(cell)
        await place(cell)
        await cell.clock.sleep(25.0)
        await cell.crash()
        assert cell.snapshot.branches["placement"] == "unknown"
        await cell.clock.sleep(40.0)
        assert cell.snapshot.branches["placement"] == "unknown"

    run_simulated(course, WORKFLOW, (*QUICK, "procedure.limits.idle_s=30"))
