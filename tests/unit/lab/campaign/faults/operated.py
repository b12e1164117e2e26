"""A cell that is operated in simulated time: motions take time, Stop holds them, and a fault of the scene acts."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, cast

import msgspec

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Decision, DeviceEvent, JointState, Reason, Running, Snapshot, Verdict
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.lab import Lab
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, ScriptedLab, ScriptedScene, run
from tests.unit.lab.scripted_client import Answer, ScriptedClient, row

__all__ = ["AffectedScene", "Operated", "OperatedCell", "lab_of", "run"]

READY = {
    "registration": "111",
    "digitization": "1",
    "toolplan": "1",
    "robot": "1",
    "placement": "retracted",
    "alignment": "1",
    "stimulation": "disarmed",
}
MOTIONS = {
    "placement.approach": "standoff",
    "placement.confirm": "placed",
    "placement.nudge": "placed",
    "placement.home": "retracted",
    "placement.back_off": "standoff",
}
"""Motions, and the state to which each leads."""
LEADS: dict[str, dict[str, str]] = {
    "robot.connect": {"robot": "1"},
    "robot.disconnect": {"robot": "0"},
    "registration.plan_landmarks": {"registration": "100", "digitization": "0"},
    "registration.register": {"registration": "111"},
    "registration.clear_registration": {"registration": "110"},
    "registration.reinit": {"registration": "000", "digitization": "0"},
    "digitization.digitize_all": {"registration": "110", "digitization": "1"},
    "toolplan.plan": {"toolplan": "1"},
    "toolplan.clear": {"toolplan": "0"},
    "toolplan.reinit": {"toolplan": "0"},
    "placement.follow": {"placement": "following"},
    "placement.stop_following": {"placement": "placed"},
    "placement.locate": {"placement": "retracted"},
    "stimulation.arm": {"stimulation": "armed"},
    "stimulation.disarm": {"stimulation": "disarmed"},
}
LASTS = 2.0
"""Duration of a motion, s of the loop."""
STEP = 0.05
"""Time between two messages of the joints, s of the loop."""
NO_FREE_PASS = ("robot.acknowledge", "robot.connect", "registration.reinit", "toolplan.reinit", "lease.acquire")
"""Operations that are accepted while Stop is latched."""


class Operated(ScriptedClient):
    """A client of that cell.

    Attributes:
        refuses: Code with which an operation is refused, or a function of its arguments that returns one.
        ends: Decision and state with which a motion ends when it is stopped.
        restless: The arm moves although nothing lets it.
        deaf: Stop does not latch.
    """

    def __init__(self, **branches: str) -> None:
        super().__init__(**(READY | branches))
        self.leads |= LEADS
        self.refuses: dict[str, str | Callable[[Mapping[str, Any]], str]] = {}
        self.ends: tuple[Any, str] = ("failed", "held")
        self.restless = False
        self.deaf = False
        self.silent_joints = False
        self.plan: str | None = "plan-1"
        self.registration: str | None = "registration-1"
        self._listeners: dict[str, list[Callable[[Any], None]]] = {}
        self._joints: asyncio.Task[None] | None = None
        self._lost: str | None = None

    def listen(self, key: str, kind: type, handler: Callable[[Any], None]) -> Callable[[], Awaitable[None]]:
        self._listeners.setdefault(key, []).append(handler)
        loop = asyncio.get_running_loop()
        if key == "state/joints" and (self._joints is None or self._joints.get_loop() is not loop):
            self._joints = loop.create_task(self._publish_joints())

        async def end() -> None:
            self._listeners[key].remove(handler)

        return end

    def tell(self, key: str, message: Any) -> None:
        """Delivers a message to who listens."""
        for handler in list(self._listeners.get(key, ())):
            handler(message)

    async def _publish_joints(self) -> None:
        number = 0
        while self._listeners["state/joints"]:
            if not self.silent_joints:
                moves = bool(self.running) or self.restless
                number += moves
                self.tell("state/joints", _joints(0.1 * number, 0.2 if moves else 0.0))
            await asyncio.sleep(STEP)
        self._joints = None

    def hold(self, code: str = "", *, danger: bool = True) -> None:
        """Latches as a danger does, and reports it."""
        if code:
            self.tell("dev/robot/event", DeviceEvent(device="robot", code=code, text=f"It is {code}.", danger=danger))
        self.latched = True
        self.stop_state = msgspec.structs.replace(self.stop_state, number=self.stop_state.number + 1, confirmed=True)
        if self.branches["placement"] in ("standoff", "placed", "following"):
            self.branches["placement"] = "held"

    def lose(self) -> None:
        """Loses the robot: what a motion has come to is unknown."""
        self.ends = ("unknown", "unknown")
        self.hold()
        self.branches |= {"robot": "0", "placement": "unknown"}

    async def stop(self, timeout: float = 0.0) -> None:
        if self.silent:
            raise UnknownOutcomeError("The daemon does not answer.")
        self.rows.append(row("device", operation="stopped", source="bus:local"))
        if not self.deaf:
            self.hold()

    async def state(self, timeout: float = 0.0) -> Snapshot:
        shown = await super().state()
        registered = self.registration if self.branches["registration"] == "111" else None
        return msgspec.structs.replace(shown, plan=self.plan, registration=registered)

    async def call(
        self, name: str, arguments: Mapping[str, Any] | None = None, *, id: str | None = None, timeout: float = 0.0
    ) -> Verdict:
        refusal = self.refuses.get(name, "")
        code = refusal(arguments or {}) if callable(refusal) else refusal
        if self.latched and not code and name.startswith("placement."):
            code = "latched"
        if code:
            self.answers[name] = [("rejected", Reason(code=code, text=f"It is {code}."))]
        elif name in MOTIONS and not self.answers.get(name):
            await self._move(name, id)
        verdict = await super().call(name, arguments, id=id)
        if (name, verdict.decision) == ("robot.acknowledge", "accepted"):
            self.latched = False
        if (name, verdict.decision) == ("toolplan.plan", "accepted"):
            self.plan = f"plan-{self.sequence}"
        return verdict

    async def _move(self, name: str, id: str | None) -> None:
        branch, _, operation = name.partition(".")
        self.rows.append(row("intent", branch=branch, operation=operation, command_id=id or "m", source="bus:local"))
        self.running.append(Running(branch=branch, operation=operation, id=id or "m"))
        waited = 0.0
        while waited < LASTS and not self.latched:
            await asyncio.sleep(STEP)
            waited += STEP
        self.running.clear()
        decision, state = self.ends if self.latched else ("accepted", MOTIONS[name])
        self.branches["placement"] = state
        self.leads[name] = {}
        reason = None if decision == "accepted" else Reason(code="stopped", text="It was stopped.")
        answer: Answer = (cast(Decision, decision), reason)
        self.answers[name] = [answer]


def _joints(position: float, speed: float) -> JointState:
    at = asyncio.get_running_loop().time()
    return JointState(
        captured=at, sent=at, positions=[position, 0.0], velocities=[speed, 0.0], torques=[0.0, 0.0], moving=speed > 0.0
    )


class AffectedScene(ScriptedScene):
    """A scene whose faults do something.

    Attributes:
        effects: Called with the arguments of a fault, by its name.
    """

    def __init__(self, *places: tuple[float, float, float]) -> None:
        super().__init__(*places)
        self.effects: dict[str, Callable[[dict[str, Any]], None]] = {}

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        await super().inject(fault, arguments)
        if fault in self.effects:
            self.effects[fault](arguments)


class OperatedCell(ScriptedCell):
    """A running cell with that client and that scene."""

    client: Operated
    scene: AffectedScene

    def __init__(self, folder: Path = Path("cell1"), **branches: str) -> None:
        super().__init__(folder)
        self.client = Operated(**branches)
        self.scene = AffectedScene()


def lab_of(folder: Path, *cells: ScriptedCell) -> Lab:
    """A lab of these cells; a daemon without guards is a cell that refuses nothing."""
    lab = ScriptedLab(folder, *cells)
    lab.unguarded = OperatedCell()
    return lab.as_lab


def proves(evidence: Evidence) -> bool:
    """Whether a row has measured its fault and its control; `test_injections.py` checks which control a class needs."""
    return evidence.missing("order") == ""
