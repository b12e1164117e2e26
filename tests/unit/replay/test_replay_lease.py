"""Who holds the cell, who is refused for it, and who loses it in motion, is decided again as it was."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.dispatcher.lease import Lease
from pcmrs.messages.identity import Role
from tests.unit.replay.random_course import Course
from tests.unit.replay.test_replay_random import decide_anew, on_simulated_time, on_the_way

Asked = tuple[str, Role, str, dict[str, Any]]

CHANGES: list[Asked] = [
    ("anna", "operator", "lease.acquire", {}),
    ("bob", "operator", "registration.plan_landmarks", {"values": [0.0]}),
    ("eve", "viewer", "registration.plan_landmarks", {"values": [0.0]}),
    ("bob", "operator", "lease.take_over", {}),
    ("anna", "operator", "lease.confirm", {"user": "eve"}),
    ("anna", "operator", "lease.confirm", {"user": "bob"}),
    ("bob", "operator", "lease.release", {}),
    ("anna", "operator", "lease.release", {}),
    ("anna", "operator", "lease.acquire", {}),
]


async def settled(course: Course) -> None:
    for _ in range(3):
        await asyncio.sleep(1.0)
        course.flush(99)
        course.confirm(stands=True)
    await asyncio.sleep(1.0)


async def handed_on(*, in_motion: str) -> Course:
    course = Course()
    await on_the_way(course, 6)  # the robot is connected, and the arm located
    for user, role, name, arguments in CHANGES:
        course.ask(user, role, name, arguments)
        await settled(course)
    course.ask("anna", "operator", "placement.approach", {})
    await asyncio.sleep(1.0)
    course.flush(99)
    await asyncio.sleep(1.0)
    if in_motion == "lost":
        course.lose_holder(moving=True)
    else:
        course.ask("local", "operator", "lease.take_over", {})
    await settled(course)
    course.lose_holder(moving=False)
    await settled(course)
    course.ask("bob", "operator", "robot.acknowledge", {})
    await settled(course)
    await course.close()
    return course


@pytest.mark.parametrize("in_motion", ["lost", "taken"])
def test_lease_decisions_are_replayed(in_motion: str, monkeypatch: pytest.MonkeyPatch) -> None:
    course = on_simulated_time(handed_on(in_motion=in_motion))
    codes = [each.row.verdict.reason.code for each in course.rows if each.row.verdict and each.row.verdict.reason]
    assert {"lease_held", "role_not_allowed", "bad_arguments", "not_holder"} <= set(codes)
    assert {"lost": "lease_lapsed", "taken": "lease_taken"}[in_motion] in codes
    assert decide_anew(course).differences == []
    monkeypatch.setattr(Lease, "objection", lambda *_: None)
    assert decide_anew(course).differences
