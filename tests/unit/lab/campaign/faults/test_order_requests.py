"""Rows of late requests: a request that comes after the hold moves nothing, and was late by what the process says."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.delays import Delayed, Rule
from pcmrs_lab.campaign.faults import order_requests
from pcmrs_lab.campaign.faults.order_requests import LATE, delayed, late_motion
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run

RULE = Rule("receive", "dev/robot/cmd", "follow", LATE)


class ScriptedDelays:
    """Delays that a test performs.

    Attributes:
        arrives: Called when the delayed frame comes.
        rules: Rules, in order.
    """

    def __init__(self) -> None:
        self.rules: list[Rule] = []
        self.arrives: Callable[[], None] = lambda: None
        self.overtaken = 2

    @asynccontextmanager
    async def delaying(self, *rules: Rule, ended: bool = True) -> AsyncIterator[None]:
        self.rules += rules
        yield

    async def wait_until_delaying(self, _: Rule) -> None:
        await asyncio.sleep(0.1)

    async def wait_until_delayed(self, rule: Rule) -> list[Delayed]:
        self.arrives()
        return [Delayed(rule=rule, begun=10.0, ended=10.0 + LATE, overtaken=self.overtaken)]


@pytest.fixture
def delays(monkeypatch: pytest.MonkeyPatch) -> ScriptedDelays:
    made = ScriptedDelays()
    monkeypatch.setattr(order_requests, "delays_of", lambda _: made)
    return made


def test_the_evidence_is_what_the_delayed_process_says() -> None:
    late = [
        Delayed(rule=RULE, begun=1.0, ended=1.25, overtaken=3),
        Delayed(rule=RULE, begun=2.0, ended=2.5, overtaken=1),
    ]
    found = delayed("no joint moved", late, [0.001], again="accepted")
    assert found.took_place == {"delayed": 2, "late_s": [0.25, 0.5]}
    assert found.details == {"overtaken_by": 4, "moved_deg": 0.057}
    assert found.control == {"again": "accepted"}
    assert proves(found)
    assert not proves(delayed("no joint moved", [], [0.0], again="accepted")), "nothing was late"
    assert "moved_deg" not in delayed("no joint moved", late, again="accepted").details


@pytest.mark.parametrize(
    ("row", "place", "motion"),
    [
        (order_requests.sent_late, "send", "placement.approach"),
        (order_requests.delivered_late, "receive", "placement.approach"),
        (order_requests.confirm_late, "receive", "placement.confirm"),
        (order_requests.retreat_late, "receive", "placement.home"),
    ],
)
def test_a_late_request_moves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays, row: Any, place: str, motion: str
) -> None:
    cell = OperatedCell()
    found = run(monkeypatch, row(lab_of(tmp_path, cell)))
    assert proves(found)
    assert found.control == {"moved_the_arm_when_asked_again": "accepted"}
    assert [(rule.place, rule.word) for rule in delays.rules] == [(place, "follow")]
    assert cell.client.asked.count(motion) >= 2


def test_a_late_request_that_moves_the_arm_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()
    delays.arrives = lambda: setattr(cell.client, "restless", True)
    with pytest.raises(Unmet, match=r"A joint moved by .* although no motion is allowed"):
        run(monkeypatch, order_requests.delivered_late(lab_of(tmp_path, cell)))


def test_a_motion_that_works_no_more_proves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()

    def once(_: Any) -> str:
        return "broken" if cell.client.asked.count("placement.approach") else ""

    cell.client.refuses["placement.approach"] = once
    with pytest.raises(Unmet, match="The arm does not move"):
        run(monkeypatch, order_requests.delivered_late(lab_of(tmp_path, cell)))
    assert delays.rules


def test_the_loop_of_the_daemon_stands_still_meanwhile(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    run(monkeypatch, order_requests.after_the_node_s_own_hold(lab_of(tmp_path, OperatedCell())))
    assert [(rule.place, rule.seconds) for rule in delays.rules] == [("receive", LATE), ("pass", 2 * LATE)]


def test_what_a_stopped_motion_ends_as_is_looked_at(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()
    cell.client.ends = ("rejected", "held")

    async def prepare(client: Any) -> None:
        cell.client.branches["placement"] = "retracted"

    with pytest.raises(Unmet, match=r"placement\.approach ended rejected"):
        run(monkeypatch, late_motion(lab_of(tmp_path, cell), "receive", prepare, "placement.approach"))
    assert delays.rules[0].seconds == LATE


def test_a_stimulator_is_not_armed_after_stop(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell(placement="placed")
    snapshots: list[dict[str, Any]] = []

    async def request(*_: Any) -> dict[str, Any]:
        snapshots.append({"armed": cell.client.branches["stimulation"] == "armed", "intensity": 50.0})
        return snapshots[-1]

    monkeypatch.setattr(cell.client, "request_device", request)
    cell.client.refuses["stimulation.arm"] = lambda _: "latched" if len(snapshots) == 1 else ""
    found = run(monkeypatch, order_requests.arming_late(lab_of(tmp_path, cell)))
    assert proves(found)
    assert found.control == {"asked_again": "accepted", "changed": ["armed"]}


def test_a_stimulator_that_is_armed_by_it_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell(placement="placed")
    cell.client.devices["stimulator.state"] = {"armed": True, "intensity": 50.0}
    cell.client.refuses["stimulation.arm"] = "latched"
    with pytest.raises(Unmet, match="armed after Stop"):
        run(monkeypatch, order_requests.arming_late(lab_of(tmp_path, cell)))


def test_a_hand_that_was_stopped_touches_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, delays: ScriptedDelays
) -> None:
    cell = OperatedCell()
    cell.client.answers["digitization.digitize_one"] = [("failed", None)]
    cell.client.results["digitization.digitize_one"] = {"spreads": {"p1": 0.0005}}
    found = run(monkeypatch, order_requests.touch_late(lab_of(tmp_path, cell)))
    assert found.control == {"asked_again": "accepted", "touched_with_spread_mm": {"p1": 0.5}}
    cell.client.answers["digitization.digitize_one"] = [("failed", None)]
    delays.arrives = lambda: setattr(cell.scene, "tip", (0.1, 0.0, 0.0))
    with pytest.raises(Unmet, match="The hand was at None, and after Stop at"):
        run(monkeypatch, order_requests.touch_late(lab_of(tmp_path, cell)))
