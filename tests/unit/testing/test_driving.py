"""Operating a cell: each command must be accepted, and any state leads back to the beginning."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from itertools import product
from typing import Any, cast

import msgspec
import pytest

from pcmrs.client import Client
from pcmrs.messages import BlueprintTag, DeviceEvent, JointState, Reason, Snapshot, Verdict
from pcmrs.testing import driving
from pcmrs.testing.devices import STATE
from pcmrs.testing.driving import accept, approach_alone, connect, moving, reset_cell, showing, to_placed, until
from pcmrs.testing.errors import Unmet

CLEAR = ("unknown", "retracted")
NEAR = ("placed", "following", "guided", "held")
MOVES = {"placement.home", "placement.approach", "placement.confirm", "placement.back_off"}


class Cell:
    """A cell with the rules of the workflow ratms that matter to who drives it; it stands in for a client."""

    def __init__(self, placement: str = "unknown", robot: str = "0", latched: bool = False, **more: str) -> None:
        self.branches = {"registration": "000", "toolplan": "0", "robot": robot, "placement": placement, **more}
        self.latched = latched
        self.calls: list[str] = []
        self.refusals = 0
        self.velocity = 0.1
        self._look: Callable[[JointState], None] | None = None

    async def call(self, name: str, _arguments: object = None, **_more: object) -> Verdict:
        self.calls.append(name)
        why = self._objection(name)
        if why is None:
            self._perform(name)
            await asyncio.sleep(0.02 if name in MOVES else 0.0)  # a motion takes time
        reason = None if why is None else Reason(code="not_now", text=why)
        branch, _, operation = name.partition(".")
        state = self.branches.get(branch, "")
        decision: Any = "accepted" if why is None else "rejected"
        return Verdict(
            id="1", branch=branch, operation=operation, decision=decision, state=state, sequence=1, reason=reason
        )

    async def acknowledge(self, *, stop: int | None = None) -> Verdict:
        return await self.call("robot.acknowledge")

    async def state(self) -> Snapshot:
        return Snapshot(
            sequence=len(self.calls),
            branches=dict(self.branches),
            flags={},
            running=[],
            latched=self.latched,
            blueprint=BlueprintTag(id="test", version="1", hash="0"),
        )

    async def watch(self) -> AsyncGenerator[Snapshot | DeviceEvent, None]:
        yield DeviceEvent(device="tracker", code="late", text="The tracker is late.")
        yield await self.state()
        await asyncio.Event().wait()

    def listen(
        self, key: str, _kind: type[JointState], look: Callable[[JointState], None]
    ) -> Callable[[], Awaitable[None]]:
        assert key == "state/joints"
        self._look = look

        async def end() -> None:
            self._look = None

        return end

    def _objection(self, name: str) -> str | None:
        placement, robot = self.branches["placement"], self.branches["robot"]
        if self.refusals:
            self.refusals -= 1
            return "The cabinet is not ready."
        if self.latched and name in MOVES | {"robot.disconnect"}:
            return "Stop is latched."
        if name in MOVES and robot == "0":
            return "The robot is not connected."
        if name == "placement.home" and placement == "held":
            return "The tool is held."
        if name == "robot.disconnect" and placement not in CLEAR:
            return "The tool is near the body."
        if name == "placement.approach" and placement in NEAR:
            return "The tool is at the body already."
        if name == "placement.confirm" and placement != "standoff":
            return "The tool is not at the standoff."
        return None

    def _perform(self, name: str) -> None:
        if self._look is not None and name in MOVES:
            self._look(msgspec.structs.replace(STATE, velocities=[self.velocity] * 7))
        if name == "robot.acknowledge":
            self.latched = False
        states = {
            "robot.connect": {"robot": "1", "placement": "retracted"},
            "robot.disconnect": {"robot": "0", "placement": "unknown"},
            "placement.home": {"placement": "retracted"},
            "placement.back_off": {"placement": "standoff"},
            "placement.approach": {"placement": "standoff"},
            "placement.confirm": {"placement": "placed"},
            "registration.register": {"registration": "111"},
            "registration.reinit": {"registration": "000"},
            "toolplan.plan": {"toolplan": "1"},
            "toolplan.reinit": {"toolplan": "0"},
            "stimulation.disarm": {"stimulation": "disarmed"},
        }
        self.branches |= states.get(name, {})


def client_of(cell: Cell) -> Client:
    return cast("Client", cell)


async def test_a_refusal_is_reported_with_its_reason() -> None:
    cell = Cell(latched=True, robot="1")
    with pytest.raises(Unmet, match=r"placement\.home was rejected: not_now: Stop is latched"):
        await accept(client_of(cell), "placement.home")
    await accept(client_of(cell), driving.ACKNOWLEDGE)
    assert (await accept(client_of(cell), "placement.home")).decision == "accepted"


PLACEMENTS = (*CLEAR, "standoff", *NEAR)


@pytest.mark.parametrize(("placement", "latched", "armed"), list(product(PLACEMENTS, (False, True), (False, True))))
async def test_every_state_is_reset(placement: str, latched: bool, armed: bool) -> None:
    for robot in ("0", "1"):
        cell = Cell(placement, robot, latched, registration="111", toolplan="1")
        cell.branches["stimulation"] = "armed" if armed else "disarmed"
        await reset_cell(client_of(cell))
        assert not cell.latched
        expected = {"registration": "000", "toolplan": "0", "robot": "0", "stimulation": "disarmed"}
        assert expected.items() <= cell.branches.items()
        if armed:
            assert cell.calls[0] == "stimulation.disarm", "the stimulator is made safe before the arm moves"


@pytest.mark.parametrize("placement", PLACEMENTS)
async def test_the_tool_is_placed_from_every_state(placement: str) -> None:
    cell = Cell(placement, robot="0" if placement == "unknown" else "1")
    await to_placed(client_of(cell))
    assert (cell.branches["placement"], cell.branches["registration"]) == ("placed", "111")
    cell.calls.clear()
    await to_placed(client_of(cell))
    assert cell.calls == [], "nothing is done twice"


async def test_a_cabinet_that_is_ready_later_is_connected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving, "RETRY", 0.0)
    cell = Cell()
    cell.refusals = 3
    await connect(client_of(cell))
    assert cell.calls == 4 * ["robot.connect"]
    cell.refusals = 10**9
    monkeypatch.setattr(driving, "PATIENCE", 0.05)
    with pytest.raises(Unmet, match=r"not connected within 0\.05 s"):
        await connect(client_of(cell))


async def test_a_state_that_does_not_come_is_reported_with_the_last() -> None:
    client = client_of(Cell("standoff"))
    assert (await until(client, showing(placement="standoff", robot="0"))).branches["placement"] == "standoff"
    with pytest.raises(Unmet, match=r"did not come within 0\.05 s; shown last: .*'placement': 'standoff'"):
        await until(client, showing(placement="placed"), within=0.05)


async def test_a_motion_is_awaited_until_the_arm_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driving, "SEEN", 0.0)
    monkeypatch.setattr(driving, "PATIENCE", 0.2)
    cell = Cell("retracted", robot="1", registration="111", toolplan="1")
    assert (await approach_alone(client_of(cell))).state == "standoff"
    cell.velocity = 0.0
    with pytest.raises(Unmet, match="The arm does not move"):
        async with moving(client_of(cell), "placement.home"):
            raise AssertionError
    cell.velocity, cell.latched = 0.1, True
    with pytest.raises(Unmet, match=r"The arm does not move: .*Stop is latched"):
        async with moving(client_of(cell)):
            raise AssertionError
