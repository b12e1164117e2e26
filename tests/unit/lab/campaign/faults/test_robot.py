"""Rows of a robot's faults: what a motion may end as, and what shows that replies were framed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.messages import PoseMessage
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import robot
from pcmrs_lab.campaign.receivers import Segments
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.scripted_client import failed, verdict


@pytest.fixture
def cell() -> OperatedCell:
    return OperatedCell()


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: OperatedCell, row: Injector) -> Evidence:
    return run(monkeypatch, row(lab_of(folder, cell)))


def stops(cell: OperatedCell, name: str, code: str) -> None:
    """Lets a fault of the scene stop the arm, which reports `code`."""
    cell.scene.effects[name] = lambda arguments: cell.client.hold(code) if arguments.get("on", True) else None


@pytest.mark.parametrize(
    ("row", "name", "code"),
    [
        (robot.emergency, "e_stop", "drives_off"),
        (robot.mode, "change_mode", "drives_off"),
        (robot.brakes, "close_brakes", "drives_off"),
    ],
)
def test_a_braked_arm_is_held_until_confirmed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell, row: Any, name: str, code: str
) -> None:
    stops(cell, name, code)
    found = ran(monkeypatch, tmp_path, cell, row)
    assert proves(found)
    assert found.took_place == {f"events {code}": 1}
    assert found.control == {"the next motion, without the fault": "accepted"}


def test_a_fault_that_was_not_injected_is_found_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    stops(cell, "e_stop", "drives_off")
    with sham(), pytest.raises(Unmet, match="ended accepted in standoff"):
        ran(monkeypatch, tmp_path, cell, robot.emergency)


def test_a_stop_that_nobody_reports_is_not_seen(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    stops(cell, "e_stop", "something_else")
    with pytest.raises(Unmet, match="No client has seen 'e_stop'"):
        ran(monkeypatch, tmp_path, cell, robot.emergency)


def test_an_arm_that_continues_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell) -> None:
    stops(cell, "e_stop", "drives_off")
    cell.scene.places = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.01)]
    with pytest.raises(Unmet, match=r"moved by 10\.00 mm"):
        ran(monkeypatch, tmp_path, cell, robot.emergency)


def loses(cell: OperatedCell, name: str) -> None:
    def lose(arguments: dict[str, Any]) -> None:
        if arguments.get("on", True):
            cell.client.silent_joints = True
            cell.client.lose()
        else:
            cell.client.silent_joints = False

    cell.scene.effects[name] = lose
    cell.client.leads["robot.connect"] = {"robot": "1", "placement": "held"}


def test_a_lost_robot_is_unknown_until_located(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    loses(cell, "cut_robot")
    found = ran(monkeypatch, tmp_path, cell, robot.cut)
    assert proves(found)
    assert found.took_place["no joints for_s"] > robot.SETTLING
    assert found.details["begun"] == 1


def test_a_motion_that_begins_again_by_itself_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    loses(cell, "cut_robot")

    def refuse(_: Any) -> str:
        cell.client.rows += [each for each in cell.client.rows if each.kind == "intent"]
        return ""

    cell.client.refuses["robot.connect"] = refuse
    with pytest.raises(Unmet, match="began 2 times"):
        ran(monkeypatch, tmp_path, cell, robot.cut)


@pytest.mark.parametrize("ending", [("failed", "held"), ("unknown", "unknown")])
def test_a_motion_may_end_in_some_ways_only(ending: tuple[Any, str]) -> None:
    decision, state = ending
    seen = verdict(decision=decision, code="stopped", state=state)
    robot._expect_end(seen, *robot.REPORTED)
    with pytest.raises(Unmet, match=r"ended accepted in standoff \(no reason\); expected unknown in unknown"):
        robot._expect_end(verdict(state="standoff"), *robot.UNKNOWN)


WHOLE = Segments(received=100, sent=100)


@pytest.mark.parametrize(
    ("framing", "seen", "measured"),
    [
        ("split", Segments(300, 100), 200),
        ("mixed", Segments(150, 100), 50),
        ("merged", Segments(40, 40), 0.03),
    ],
)
def test_framed_replies_differ_from_whole_ones(framing: str, seen: Segments, measured: float) -> None:
    assert robot._framed(framing, seen, WHOLE) == pytest.approx(measured)


@pytest.mark.parametrize(
    ("framing", "seen", "text"),
    [
        ("split", Segments(102, 100), "do not come in several segments when split"),
        ("merged", Segments(99, 99), "not held back"),
        ("merged", Segments(0, 0), "No replies are counted"),
        ("split", Segments(1, 0), "No replies are counted"),
    ],
)
def test_replies_that_came_whole_prove_nothing(framing: str, seen: Segments, text: str) -> None:
    with pytest.raises(Unmet, match=text):
        robot._framed(framing, seen, WHOLE)


def test_a_step_that_raises_keeps_the_state(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    cell.client.branches["robot"] = "0"

    def refuse(arguments: dict[str, Any]) -> None:
        cell.client.answers["robot.connect"] = [failed("robot_refuses")] if arguments["on"] else []

    cell.scene.effects["refuse_robot"] = refuse
    found = ran(monkeypatch, tmp_path, cell, robot.raising)
    assert proves(found)
    assert found.control == {"connected when it did not refuse": True}


def test_an_interrupted_motion_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell) -> None:
    cell.scene.effects["interrupt"] = lambda _: cell.client.hold()
    with pytest.raises(Unmet, match="The reason is another one: stopped"):
        ran(monkeypatch, tmp_path, cell, robot.interrupted)


def test_a_pose_out_of_reach_is_refused_while_it_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    def shift(arguments: dict[str, Any]) -> None:
        away = arguments["millimetres"] > 0
        cell.client.refuses["placement.approach"] = "unreachable" if away else ""
        cell.scene.reference = PoseMessage(position=(1.5 * away, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))

    cell.scene.effects["shift_body"] = shift
    found = ran(monkeypatch, tmp_path, cell, robot.unreachable)
    assert proves(found)
    assert found.took_place == {"the head is elsewhere by_m": 1.5}
