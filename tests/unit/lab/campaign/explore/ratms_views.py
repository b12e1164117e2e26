"""Snapshots of RATMS that are as a daemon would publish them, and what a session knows of it."""

from __future__ import annotations

from typing import Any

from pcmrs.messages import ActiveActivity, Command, DeviceEvent, JointState, Running, Snapshot, Verdict
from pcmrs_lab.campaign.explore.view import View
from tests.unit.lab.blueprints import ratms
from tests.unit.lab.scripted_client import TAG, verdict

READY = {"registration": "111", "digitization": "1", "toolplan": "1", "robot": "1", "placement": "retracted"}
"""Everything is there for an approach."""
PLACED = READY | {"placement": "placed"}

APPROACH = Running(branch="placement", operation="approach", id="a1")
PLAN = Running(branch="toolplan", operation="plan", id="p1")
FOLLOWS = ActiveActivity(branch="placement", state="following", name="follow_head")


def shown(sequence: int = 1, *, latched: bool = False, states: dict[str, str] | None = None, **more: Any) -> Snapshot:
    branches = ratms().initial() | (states or {})
    flags = {
        flag: digit == "1"
        for name, branch in ratms().branches.items()
        for flag, digit in zip(branch.flags, branches[name], strict=False)
    }
    given: dict[str, Any] = {"flags": flags, "running": [], "blueprint": TAG}
    return Snapshot(sequence=sequence, branches=branches, latched=latched, **(given | more))


def view(*snapshots: Snapshot, now: float = 100.0) -> View:
    """What is known after these were published."""
    known = View(ratms(), now=now)
    known.begin_run()
    for snapshot in snapshots:
        known.take_snapshot(snapshot)
    return known


def joints(speed: float, captured: float = 100.0) -> JointState:
    return JointState(
        captured=captured, sent=captured, positions=[0.0, 0.0], velocities=[0.0, -speed], torques=[0.0, 0.0]
    )


def event(code: str, *, danger: bool = False, device: str = "robot") -> DeviceEvent:
    return DeviceEvent(device=device, code=code, text=f"It is {code}.", danger=danger)


def command(name: str = "placement.approach", number: str = "1", who: str = "anna") -> Command:
    branch, _, operation = name.partition(".")
    return Command(id=number, branch=branch, operation=operation, source=f"bus:{who}", arguments={}, sent=0.0, ttl=20.0)


def decided(name: str = "placement.approach", decision: Any = "accepted", code: str = "", **more: Any) -> Verdict:
    return verdict(name, decision, code, **more)
