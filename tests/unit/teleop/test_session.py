"""The teleoperator's program against a daemon that is played: it engages, sends, releases, and never insists."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import pytest

from pcmrs.client import Client
from pcmrs.errors import CommandRefusedError
from pcmrs.messages import BlueprintTag, DeviceEvent, Reason, Snapshot, TeleopSetpoint, TeleopStatus, Verdict
from pcmrs.messages.teleop import AT_REST
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.teleop.demand import Demand
from pcmrs.teleop.session import Report, TeleopSession

UP = (0.0, 0.0, 0.01, 0.0, 0.0, 0.0)
HOLDING = Demand(UP, clutch=True)
LET_GO = Demand()


@dataclass
class Hands:
    """An input device that a test moves."""

    now: Demand = LET_GO

    def demand(self, _now: float) -> Demand:
        return self.now


@dataclass
class PlayedDaemon:
    """Answers as a daemon does, 10 ms away, and tells a status every 20 ms while the tool is guided."""

    placement: str = "standoff"
    engaged_by: str | None = None
    refuse: str = ""
    user: str = "alice"
    asked: list[str] = field(default_factory=list)
    setpoints: list[TeleopSetpoint] = field(default_factory=list)
    stops: int = 0
    stands_after: float = 0.0
    stood: float | None = None
    sequence: int = 7
    handlers: dict[str, Callable[[Any], None]] = field(default_factory=dict)

    def snapshot(self) -> Snapshot:
        branches = {"placement": self.placement, "teleoperation": "engaged" if self.engaged_by else "off"}
        tag = BlueprintTag(id="ratms", version="1", hash="")
        return Snapshot(sequence=self.sequence, branches=branches, flags={}, running=[], latched=False, blueprint=tag)

    async def state(self) -> Snapshot:
        return self.snapshot()

    async def call(self, name: str, arguments: Mapping[str, Any] | None = None, timeout: float = 0.0) -> Verdict:
        self.asked.append(name)
        await asyncio.sleep(0.01)
        if self.refuse == name:
            return self.verdict(name, "rejected")
        self.sequence += 1
        self.placement = "held" if name == "placement.stop_guiding" else "guided"
        self.engaged_by = "alice" if name == "teleoperation.engage" else None
        self.handlers["state/fsm"](self.snapshot())
        if self.placement == "held":
            self.handlers["state/event"]({"device": "activity:watch_alignment", "code": "activity_ended"})
            asyncio.get_running_loop().call_later(self.stands_after, self.stand)
        return self.verdict(name, "accepted")

    def stand(self) -> None:
        """The activity that follows the set points has ended."""
        self.stood = asyncio.get_running_loop().time()
        self.handlers["state/event"]({"device": "activity:teleoperate", "code": "activity_ended"})

    def verdict(self, name: str, decision: Any) -> Verdict:
        branch, _, operation = name.partition(".")
        reason = Reason(code="no", text="Not now.") if decision == "rejected" else None
        return Verdict(
            id="1",
            branch=branch,
            operation=operation,
            decision=decision,
            state="",
            reason=reason,
            sequence=self.sequence,
        )

    def listen(self, key: str, kind: type, handler: Callable[[Any], None]) -> Callable[[], Awaitable[None]]:
        self.handlers[key] = handler

        async def end() -> None:
            del self.handlers[key]

        return end

    def steer(self, setpoint: TeleopSetpoint) -> None:
        self.setpoints.append(setpoint)

    async def stop(self) -> None:
        self.stops += 1

    async def tell(self) -> None:
        while True:
            await asyncio.sleep(0.02)
            if self.placement == "guided" and "state/teleop" in self.handlers:
                stamp = asyncio.get_running_loop().time()
                self.handlers["state/teleop"](TeleopStatus(stamp=stamp, user=self.engaged_by))


@dataclass
class Played:
    daemon: PlayedDaemon
    hands: Hands
    told: list[Report]
    session: TeleopSession


def played(**given: Any) -> Played:
    daemon, hands, told = PlayedDaemon(**given), Hands(), cast(list[Report], [])
    clock = SimulatedClock(asyncio.get_running_loop())
    return Played(daemon, hands, told, TeleopSession(cast(Client, daemon), hands, clock, 50.0, told.append))


async def at_work(game: Played, course: Callable[[], Awaitable[None]]) -> str:
    """Runs the session and the course beside it."""
    async with asyncio.TaskGroup() as tasks:
        telling = tasks.create_task(game.daemon.tell())
        session = tasks.create_task(game.session.run())
        await asyncio.sleep(0.2)
        await course()
        ended = await session
        telling.cancel()
    return ended


async def test_set_points_are_sent_only_while_engaged() -> None:
    """Guiding ends with the program."""
    game = played()

    async def course() -> None:
        assert not game.daemon.setpoints
        game.hands.now = HOLDING
        await asyncio.sleep(1.0)
        sent = game.daemon.setpoints
        assert 40 <= len(sent) <= 51
        assert {each.twist for each in sent} == {UP}
        assert [each.sequence for each in sent] == list(range(1, len(sent) + 1))
        assert all(0.0 <= each.sent - each.seen <= 0.04 for each in sent), "seen is the newest status"
        game.hands.now = Demand(UP)
        await asyncio.sleep(0.2)
        assert game.daemon.asked[-1] == "teleoperation.release"
        assert all(each.twist == AT_REST for each in game.daemon.setpoints[len(sent) :])
        game.hands.now = HOLDING
        await asyncio.sleep(0.2)
        game.hands.now = Demand(leave=True)

    assert await at_work(game, course) == ""
    engage, release = "teleoperation.engage", "teleoperation.release"
    assert game.daemon.asked == ["placement.guide", engage, release, engage, "placement.stop_guiding"]
    assert not game.daemon.handlers
    assert not game.told


@pytest.mark.parametrize("stands_after", [0.0, 0.7])
async def test_it_ends_when_the_tool_stands_and_not_before(stands_after: float) -> None:
    game = played(placement="guided", stands_after=stands_after)

    async def course() -> None:
        game.hands.now = Demand(leave=True)

    assert await at_work(game, course) == ""
    assert asyncio.get_running_loop().time() == game.daemon.stood


async def test_refused_teleoperator_must_let_go_before_asking_again() -> None:
    game = played(refuse="teleoperation.engage", placement="guided")

    async def course() -> None:
        game.hands.now = HOLDING
        await asyncio.sleep(0.5)
        assert game.daemon.asked == ["teleoperation.engage"]
        assert [each.reason.text for each in game.told if isinstance(each, Verdict) and each.reason] == ["Not now."]
        game.hands.now = Demand()
        await asyncio.sleep(0.1)
        game.hands.now = HOLDING
        await asyncio.sleep(0.1)
        game.hands.now = Demand(leave=True)

    await at_work(game, course)
    assert game.daemon.asked == ["teleoperation.engage"] * 2 + ["placement.stop_guiding"]
    assert not game.daemon.setpoints


async def test_a_clutch_that_others_open_stays_open_until_let_go() -> None:
    game = played(placement="guided")

    async def course() -> None:
        game.hands.now = HOLDING
        await asyncio.sleep(0.2)
        game.daemon.engaged_by = None
        await asyncio.sleep(0.1)
        many = len(game.daemon.setpoints)
        await asyncio.sleep(0.3)
        assert len(game.daemon.setpoints) == many
        game.hands.now = Demand(stop=True)
        await asyncio.sleep(0.1)
        game.hands.now = Demand(leave=True)

    await at_work(game, course)
    assert game.daemon.asked == ["teleoperation.engage", "placement.stop_guiding"]
    assert game.daemon.stops > 0


async def test_it_ends_with_what_the_cell_says_of_a_loss() -> None:
    game = played(placement="guided")

    async def course() -> None:
        game.hands.now = HOLDING
        await asyncio.sleep(0.2)
        lost = DeviceEvent(device="activity:teleoperate", code="teleoperator_lost", text="Gone.", danger=True)
        game.daemon.handlers["state/event"]({"device": lost.device, "code": lost.code, "text": "Gone.", "danger": True})
        game.daemon.placement, game.daemon.sequence = "held", game.daemon.sequence + 1
        game.daemon.handlers["state/fsm"](game.daemon.snapshot())

    assert "it is held" in await at_work(game, course)
    assert [each.code for each in game.told if isinstance(each, DeviceEvent)] == ["teleoperator_lost"]
    assert game.daemon.asked == ["teleoperation.engage"], "nothing is asked of a tool that is held"


async def test_a_tool_that_may_not_be_guided_is_left_alone() -> None:
    game = played(refuse="placement.guide")
    with pytest.raises(CommandRefusedError, match=r"Not now\."):
        await game.session.run()
    assert game.daemon.asked == ["placement.guide"]


async def test_an_old_snapshot_does_not_end_it() -> None:
    game = played()

    async def course() -> None:
        old = PlayedDaemon(placement="standoff", sequence=game.daemon.sequence - 1).snapshot()
        game.daemon.handlers["state/fsm"](old)
        await asyncio.sleep(0.1)
        game.hands.now = Demand(leave=True)

    assert await at_work(game, course) == ""
