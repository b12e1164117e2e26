"""Motions never queue: each begins in time, or is refused."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.testing.clock import settle as settle_loop


async def arrived(cell: Any) -> None:
    """Returns once everything sent to the planner's link before has been received."""
    assert (await cell.ask("get_jnt_angsxxxx_#900;")).startswith("900_accepted")


def refused(cell: Any, reason: str) -> list[str]:
    """What has been journalled and published as refused for that reason."""
    return [event.text for event in cell.core.events if event.fields["reason"] == reason]


@pytest.mark.parametrize("second", ["execute_confirmx", "adjust_tranxxxxx_0_0_0.001", "end_session_back"])
async def test_motion_during_another_is_acknowledged_but_refused(cell: Any, second: str) -> None:
    """It is never performed."""
    cell.core.gates["approach"].clear()
    assert await cell.tell("execute_motionxx;") == "ack"
    assert await cell.tell(f"{second};") == "ack"
    (text,) = refused(cell, "busy")
    assert second[:16] in text
    assert (await cell.ask(f"{second}_#1;")).endswith("_busy;")
    assert len(refused(cell, "busy")) == 2  # each has a row
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert cell.core.operations == ["approach"]
    assert await cell.tell(f"{second};") == "ack"  # the first has ended, so that this one begins
    await arrived(cell)
    assert len(cell.core.operations) > 1


async def test_motionless_command_runs_beside_a_motion(cell: Any) -> None:
    """The daemon decides whether it may: behind a motion in the gateway a plan would change what the tool goes to."""
    cell.core.gates["approach"].clear()
    await cell.tell("execute_motionxx;")
    cell.core.results["register"] = {"residual": 0.001}
    await cell.tell("start_registrati;")
    assert await cell.replies.received.get() == "1.000000"
    assert cell.core.operations == ["approach", "register"]


async def test_a_motion_waits_for_the_plan_that_came_before_it(cell: Any) -> None:
    cell.core.gates["plan"].clear()
    for command in ("target_rotxxxxxx_0_0_0_1", "target_tslxxxxxx_0_0_0", "execute_motionxx", "start_registrati"):
        await cell.tell(f"{command};")
    assert cell.core.operations == ["plan"]
    came = cell.clock.now
    cell.clock.now += 0.05
    cell.core.results["register"] = {"residual": 0.001}
    cell.core.open_gates()
    assert await cell.replies.received.get() == "1.000000"
    assert cell.core.operations == ["plan", "approach", "register"]
    assert cell.core.ages[1] == came  # its wait here is a part of the time within which its checks begin


async def test_motion_behind_a_long_command_is_refused_after_its_time(cell: Any) -> None:
    cell.core.gates["digitize_all"].clear()
    for command in ("start_autodigitz", "execute_homexxxx"):
        await cell.tell(f"{command};")
    assert (await cell.ask("execute_motionxx_#1;")).endswith("_busy;")  # one waits already
    cell.clock.expire(0.1)
    await arrived(cell)
    assert [text[:16] for text in refused(cell, "busy")] == ["execute_motionxx", "execute_homexxxx"]
    assert (await cell.ask("execute_bkoffset_#2;")).startswith("2_accepted")  # none waits any more
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert cell.core.operations == ["digitize_all", "back_off"]


async def test_a_motion_that_the_loop_takes_up_too_late_is_refused(cell: Any) -> None:
    cell.core.gates["connect"].clear()
    for command in ("rob_conn_onxxxxx", "execute_homexxxx"):
        await cell.tell(f"{command};")
    cell.clock.now += 0.2
    cell.core.open_gates()
    await arrived(cell)
    await settle_loop()
    assert len(refused(cell, "expired")) == 1
    assert cell.core.operations == ["connect"]


async def test_next_part_of_a_command_starts_when_the_last_has_ended(cell: Any) -> None:
    cell.core.branches["placement"] = "placed"
    cell.core.gates["back_off"].clear()
    reply = asyncio.ensure_future(cell.ask("end_session_back_#1;"))
    await cell.core.arrived.wait()
    cell.clock.now += 5.0
    cell.core.open_gates()
    assert (await reply).startswith("1_accepted")
    assert cell.core.operations == ["back_off", "to_initial", "reinit", "reinit"]
    assert cell.core.ages[1:] == [None, None, None]
