"""Faults of a session begin, last and end in the cell, and excuse only what they harm."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.errors import DeviceError, JournalError
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign.explore import injecting
from pcmrs_lab.campaign.explore.faults import FAULTS, HOST, NETWORK
from pcmrs_lab.campaign.explore.injecting import BY_HAND, RETRY_AFTER, Faults
from pcmrs_lab.campaign.explore.operators import Operators
from tests.unit.lab.campaign.explore.ratms_views import command, decided, shown
from tests.unit.lab.campaign.explore.scripted_session import ScriptedCell, now, witness


class Injected:
    """Faults of a scripted cell."""

    def __init__(self) -> None:
        self.cell = ScriptedCell()
        self.witness = witness()
        self.operators = Operators(self.cell.as_cell, self.witness.answered, self.witness.watcher)
        self.faults = Faults(self.cell.as_cell, self.operators, self.witness)

    @property
    def calm(self) -> bool:
        return self.witness.view.calm.holds


def during(act: Callable[[Injected], Awaitable[None]]) -> Injected:
    async def run() -> Injected:
        injected = Injected()
        await act(injected)
        return injected

    return run_on_simulated_loop(run())


def test_a_fault_of_the_scene_ends_after_its_time() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("occlude", {"body": "coil", "on": True, "lasts": 3.0})
        assert it.cell.scene.injected == [("occlude", {"body": "coil", "on": True})]
        assert not it.calm
        await it.faults.wait_until_over()
        assert now() == 3.0

    it = during(act)
    assert it.cell.scene.injected[1:] == [("occlude", {"body": "coil", "on": False})]
    assert it.calm
    assert it.faults.reached == {"occlude": 1}


def test_a_fault_that_ends_by_itself_is_not_ended() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("interrupt", {})
        await it.faults.wait_until_over()

    assert during(act).cell.scene.injected == [("interrupt", {})]


def test_a_fault_that_the_cell_refuses_was_not_injected() -> None:
    async def act(it: Injected) -> None:
        it.cell.scene.refuses = DeviceError("The arm moves.")
        await it.faults.inject("guide_by_hand", {"joint": 1})
        assert it.witness.view.by_hand == now() + BY_HAND

    it = during(act)
    assert it.faults.reached == {}
    assert it.calm


def test_it_is_calm_only_when_all_faults_have_ended() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("occlude", {"body": "coil", "on": True, "lasts": 2.0})
        await it.faults.inject("occlude", {"body": "pointer", "on": True, "lasts": 5.0})
        await asyncio.sleep(3.0)
        assert not it.calm
        await it.faults.wait_until_over()

    assert during(act).witness.view.calm.changed == 5.0


def test_an_arm_that_is_pushed_may_move_a_while_longer() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("push_tool", {"force": 20.0, "lasts": 1.0})
        assert it.witness.view.by_hand == float("inf")
        await it.faults.inject("guide_by_hand", {"joint": 1, "angle": 0.1, "lasts": 2.0})
        await asyncio.sleep(1.5)
        assert it.witness.view.by_hand == float("inf")
        await it.faults.wait_until_over()

    assert during(act).witness.view.by_hand == 2.0 + BY_HAND


@pytest.mark.parametrize(
    ("name", "given", "attribute", "value"),
    [
        ("loss", {"part": 0.2}, "loss", 0.2),
        ("duplicates", {"part": 0.5}, "duplicates", 0.5),
        ("reordering", {"part": 0.2}, "reordering", 0.2),
        ("delay", {"seconds": 0.3}, "delay", 0.3),
        ("partition", {"from": "daemon", "to": "node", "both": True}, "cut", [("daemon", "node")]),
    ],
)
def test_the_network_is_harmed_and_repaired(name: str, given: dict[str, Any], attribute: str, value: Any) -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject(name, given | {"lasts": 1.0})
        assert getattr(it.cell.conditions, attribute) == value
        await it.faults.wait_until_over()
        assert not getattr(it.cell.conditions, attribute)

    during(act)


@pytest.mark.parametrize(
    ("name", "given", "looked_at", "meanwhile", "afterwards"),
    [
        ("slow_disk", {"seconds": 2.0}, "disk.delay", 2.0, 0.0),
        ("failing_disk", {"landing": True}, "disk.failing", True, False),
        ("wall_jump", {"seconds": -3600.0}, "clock.ahead", -3600.0, 0.0),
        ("wall_frozen", {"on": True}, "clock.frozen", True, False),
    ],
)
def test_a_host_is_harmed_and_repaired(
    name: str, given: dict[str, Any], looked_at: str, meanwhile: Any, afterwards: Any
) -> None:
    async def act(it: Injected) -> None:
        part, _, attribute = looked_at.partition(".")
        await it.faults.inject(name, given | {"lasts": 1.0})
        assert getattr(getattr(it.cell, part), attribute) == meanwhile
        await it.faults.wait_until_over()
        assert getattr(getattr(it.cell, part), attribute) == afterwards

    assert during(act).witness.view.excused is (name == "failing_disk")


def test_a_clock_of_an_operator_is_wrong_for_a_while() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("skewed_operator", {"seconds": 60.0, "lasts": 1.0})
        assert it.operators.clock.ahead == 60.0
        await it.faults.wait_until_over()
        assert it.operators.clock.ahead == 0.0

    during(act)


def test_a_process_is_held_up() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("held_up", {"process": "node", "seconds": 0.5})
        await it.faults.inject("held_up", {"process": "daemon", "seconds": 0.1})

    assert during(act).cell.happened == ["node held up 0.5 s", "daemon held up 0.1 s"]


def test_commands_may_begin_later_while_the_daemon_is_held_up(monkeypatch: pytest.MonkeyPatch) -> None:
    blocked: list[tuple[float, float]] = []

    async def act(it: Injected) -> None:
        monkeypatch.setattr(it.witness.watcher, "daemon_blocked", lambda at, lasts: blocked.append((at, lasts)))
        await it.faults.inject("held_up", {"process": "node", "seconds": 0.5})
        await it.faults.inject("held_up", {"process": "daemon", "seconds": 0.1})

    during(act)
    assert blocked == [(0.0, 0.1)]


@pytest.mark.parametrize(("name", "how"), [("crash_daemon", "crashed"), ("end_daemon", "ended")])
def test_a_daemon_that_ends_is_started_again(name: str, how: str) -> None:
    async def act(it: Injected) -> None:
        it.operators.snapshot = shown()
        await it.faults.inject(name, {"lasts": 2.0})
        assert it.operators.snapshot is None, "people see that it is gone"
        await it.faults.wait_until_over()
        assert now() == 2.0

    assert during(act).cell.happened == [f"daemon {how}", "daemon started"]


def test_a_node_that_crashes_is_started_again() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("crash_node", {"lasts": 2.0})
        await it.faults.wait_until_over()

    assert during(act).cell.happened == ["node crashed", "node started"]


def test_a_start_that_a_fault_prevents_is_tried_again() -> None:
    async def act(it: Injected) -> None:
        it.cell.daemon = None
        it.cell.fails = [JournalError("The disk fails."), JournalError("The disk fails.")]
        await it.faults.start_daemon()
        assert now() == 2 * RETRY_AFTER

    it = during(act)
    assert it.cell.happened.count("daemon started") == 3
    assert it.witness.violation is None


def test_a_daemon_that_never_starts_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    async def act(it: Injected) -> None:
        it.cell.daemon = None
        it.cell.fails = [JournalError("The disk fails.")] * 9
        await it.faults.start_daemon()

    monkeypatch.setattr(injecting, "ATTEMPTS", 3)
    violation = during(act).witness.violation
    assert violation is not None
    assert (violation.invariant, violation.text) == ("the_daemon_starts_again", "The disk fails.")


def test_a_daemon_that_starts_at_the_last_attempt_has_started(monkeypatch: pytest.MonkeyPatch) -> None:
    async def act(it: Injected) -> None:
        it.cell.daemon = None
        it.cell.fails = [JournalError("The disk fails.")] * 2
        await it.faults.start_daemon()

    monkeypatch.setattr(injecting, "ATTEMPTS", 3)
    assert during(act).witness.violation is None


def test_what_people_were_told_is_compared_after_a_start() -> None:
    async def act(it: Injected) -> None:
        it.witness.watcher.answered(command(number="7"), decided(id="7"))
        await it.faults.start_daemon()

    violation = during(act).witness.violation
    assert violation is not None
    assert violation.invariant == "acknowledged_rows_last"


class ScriptedTracker:
    def __init__(self) -> None:
        self.told: list[str] = []

    def restart(self) -> None:
        self.told.append("restart")

    def stamp_ahead(self) -> None:
        self.told.append("stamp_ahead")


def test_the_tracker_is_tampered_with_if_there_is_one() -> None:
    tracker = ScriptedTracker()

    async def act(it: Injected) -> None:
        await it.faults.inject("tracker_restart", {})
        it.witness.tracker = cast(Any, tracker)
        await it.faults.inject("tracker_restart", {})
        await it.faults.inject("frame_ahead", {})

    during(act)
    assert tracker.told == ["restart", "stamp_ahead"]


SWAP = {"first": "witness", "second": "body_ref", "on": True, "lasts": 5.0}


@pytest.mark.parametrize(
    ("seen", "order", "mistaken"),
    [
        (("witness", "body_ref"), ["tool_swap"], False),
        (("witness", "body_ref"), ["tool_swap", "dash_head"], True),
        (("witness", "body_ref"), ["tool_swap", "crash_node"], True),
        (("witness", "body_ref"), ["dash_head", "tool_swap"], False),
        (("witness", "coil"), ["tool_swap"], True),
        ((), ["tool_swap"], True),
    ],
)
def test_bodies_that_no_feed_can_tell_apart_are_known(seen: tuple[str, ...], order: list[str], mistaken: bool) -> None:
    """A feed cannot tell two bodies apart that were swapped while it did not see both."""

    async def act(it: Injected) -> None:
        assert it.cell.daemon is not None
        poses = SimpleNamespace(seen=lambda body: body in seen)
        it.cell.daemon.procedure = SimpleNamespace(cell=SimpleNamespace(poses=poses))
        await asyncio.sleep(100.0)
        for name in order:
            await it.faults.inject(name, SWAP if name == "tool_swap" else {"lasts": 0.5})
            await asyncio.sleep(0.6)

    assert during(act).faults.mistaken is mistaken


def test_a_swap_while_no_daemon_runs_is_known_at_its_start() -> None:
    async def act(it: Injected) -> None:
        await it.faults.inject("crash_daemon", {"lasts": 1.0})
        await it.faults.inject("tool_swap", SWAP)
        assert not it.faults.mistaken
        await asyncio.sleep(2.0)

    assert during(act).faults.mistaken


@pytest.mark.parametrize("name", [*HOST, *NETWORK])
def test_every_fault_can_be_injected_and_ended(name: str) -> None:
    from random import Random

    async def act(it: Injected) -> None:
        await it.faults.inject(name, FAULTS[name].draw(Random(1)) | {"lasts": 0.5})
        await it.faults.wait_until_over()

    it = during(act)
    assert it.faults.reached == {name: 1}
    assert it.calm
    assert it.cell.daemon is not None
