"""Rows of a person's faults: what is forbidden is refused, what is permitted is not, and a silence is measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.driving import plan
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, Injector
from pcmrs_lab.campaign.faults import operator
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.blueprints import ratms
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.scripted_client import row


@pytest.fixture
def cell() -> OperatedCell:
    return OperatedCell()


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: OperatedCell, injection: Injector) -> Evidence:
    return run(monkeypatch, injection(lab_of(folder, cell)))


def test_a_guard_is_removed_for_the_control_only() -> None:
    freed = operator._without_guard(ratms())
    assert ratms().branches["placement"].operations["approach"].requires
    assert freed.branches["placement"].operations["approach"].requires == {}
    assert freed.branches["placement"].operations.keys() == ratms().branches["placement"].operations.keys()
    assert freed.branches["robot"] == ratms().branches["robot"]


def test_a_silence_is_the_longest_between_two_commands() -> None:
    rows = [
        row(monotonic=1.0),
        row("device", operation="stopped", monotonic=2.0),
        row(monotonic=4.0),
        row("device", operation=operator.ABANDONED_EVENT, monotonic=9.5),
        row(monotonic=10.0),
    ]
    assert operator._longest_silence(rows) == 5.5
    assert operator._longest_silence(rows[:1]) == 0.0
    assert operator._longest_silence([]) == 0.0


def refuse_lines(cell: OperatedCell) -> None:
    """Refuses landmarks on a line, or in mm."""

    def code(arguments: Any) -> str:
        points = [each["position"] for each in arguments["landmarks"]]
        if any(abs(value) > 1.0 for point in points for value in point):
            return "wrong_unit"
        return "landmarks_collinear" if all(point[2] == 0.0 for point in points) else ""

    cell.client.refuses["registration.plan_landmarks"] = code


def test_landmarks_on_a_line_are_no_plan(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell) -> None:
    refuse_lines(cell)
    found = ran(monkeypatch, tmp_path, cell, operator.collinear)
    assert proves(found)
    assert "landmarks_collinear" in found.response
    with sham(), pytest.raises(Unmet, match="plan_landmarks was accepted"):
        ran(monkeypatch, tmp_path, cell, operator.collinear)


def test_a_daemon_that_takes_a_line_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    with pytest.raises(Unmet, match="must be rejected: degenerate_points, landmarks_collinear"):
        ran(monkeypatch, tmp_path, cell, operator.collinear)


def refuse_displaced(cell: OperatedCell, code: str = "landmark_outlier") -> None:
    """Refuses a registration of touches that were displaced; each touch is displaced once."""

    def register(_: Any) -> str:
        displaced = any(isinstance(first, int) for first, _ in cell.scene.asked)
        cell.scene.asked.clear()
        return code if displaced else ""

    def approach(_: Any) -> str:
        return "requirement_not_met" if cell.client.branches["registration"] != "111" else ""

    cell.client.refuses |= {"registration.register": register, "placement.approach": approach}


@pytest.mark.parametrize("injection", [operator.swapped, operator.large_residual])
def test_touches_beside_the_landmarks_are_not_registered(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell, injection: Any
) -> None:
    refuse_displaced(cell)
    found = ran(monkeypatch, tmp_path, cell, injection)
    assert proves(found)
    assert found.response == "registration refused: landmark_outlier"
    with sham(), pytest.raises(Unmet, match=r"registration\.register was accepted"):
        ran(monkeypatch, tmp_path, cell, injection)


def test_a_displaced_touch_is_far_enough_away(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    refuse_displaced(cell)
    found = ran(monkeypatch, tmp_path, cell, operator.large_residual)
    assert 25.0 <= found.details["millimetres"] <= 50.0
    assert 0 <= found.details["landmark"] < len(plan().landmarks)


def test_a_registration_refused_for_something_else_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    refuse_displaced(cell, "busy")
    with pytest.raises(Unmet, match="must be rejected: residual_too_large"):
        ran(monkeypatch, tmp_path, cell, operator.large_residual)


def test_another_unit_and_a_mirror_image_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    refuse_lines(cell)
    refuse_displaced(cell, "mirrored")
    found = ran(monkeypatch, tmp_path, cell, operator.wrong_units)
    assert proves(found)
    assert "wrong_unit" in found.response
    assert "mirrored" in found.response
    assert len(found.took_place) == 2


def test_an_index_that_is_not_planned_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    from pcmrs.planner import PlannerVerdict

    planned = [0]

    def plan_landmarks(arguments: Any) -> str:
        planned[0] = len(arguments["landmarks"])
        return ""

    def code(arguments: Any) -> str:
        return "" if 0 <= arguments["index"] < planned[0] else "no_such_landmark"

    async def command(_: str, index: int, timeout: float = 0.0) -> PlannerVerdict:
        refused = code({"index": index})
        return PlannerVerdict("rejected" if refused else "accepted", "digitization", "0", refused or None, ())

    cell.client.refuses |= {"digitization.digitize_one": code, "registration.plan_landmarks": plan_landmarks}
    cell.planner.command = command  # type: ignore[method-assign, assignment]
    found = ran(monkeypatch, tmp_path, cell, operator.index_out_of_range)
    assert proves(found)
    assert len(found.took_place["the daemon says of each index"]) == 3
    with sham(), pytest.raises(Unmet, match="digitize_one was accepted"):
        ran(monkeypatch, tmp_path, cell, operator.index_out_of_range)
    del cell.planner.command  # accepted again
    with pytest.raises(Unmet, match="Over UDP it was accepted"):
        ran(monkeypatch, tmp_path, cell, operator.index_out_of_range)


def test_a_new_plan_ends_the_registration(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell) -> None:
    def fresh(_: Any) -> str:
        return "invalid_in_state" if cell.client.branches["registration"] != "110" else ""

    def approach(_: Any) -> str:
        return "requirement_not_met" if cell.client.branches["registration"] != "111" else ""

    cell.client.refuses |= {"registration.register": fresh, "placement.approach": approach}
    found = ran(monkeypatch, tmp_path, cell, operator.planned_again)
    assert proves(found)
    assert found.took_place["registration until the new plan"] == "registration-1"
    with sham(), pytest.raises(Unmet, match="registration, digitization and id are"):
        ran(monkeypatch, tmp_path, cell, operator.planned_again)


class Remembering(OperatedCell):
    """A cell that gives the recorded verdict to a repeated id."""

    def __init__(self) -> None:
        super().__init__()
        self.known: dict[str, Any] = {}
        call = self.client.call

        async def once(name: str, arguments: Any = None, *, id: str | None = None, timeout: float = 0.0) -> Any:
            if id is None or id not in self.known:
                verdict = await call(name, arguments, id=id, timeout=timeout)
                self.known[id or str(len(self.known))] = verdict
                return verdict
            return self.known[id]

        self.client.call = once  # type: ignore[method-assign]


def test_an_id_is_executed_once(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell) -> None:
    found = ran(monkeypatch, tmp_path, Remembering(), operator.repeated)
    assert proves(found)
    assert found.took_place == {"verdicts received for one id": 2}
    with pytest.raises(Unmet, match="Three verdicts for one id"):
        ran(monkeypatch, tmp_path, cell, operator.repeated)
    with sham(), pytest.raises(Unmet, match="Three verdicts for one id"):
        ran(monkeypatch, tmp_path, Remembering(), operator.repeated)


def test_a_plan_does_not_change_during_a_motion(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cell: OperatedCell
) -> None:
    def busy(_: Any) -> str:
        if cell.client.running:
            return "busy"
        if cell.client.branches["placement"] == "standoff":
            cell.client.branches["placement"] = "replanned"
        return ""

    cell.client.refuses |= {"toolplan.plan": busy, "registration.plan_landmarks": busy}
    cell.client.devices["robot.joints"] = {"velocities": [0.0, 0.2]}
    found = ran(monkeypatch, tmp_path, cell, operator.edited_while_moving)
    assert proves(found)
    assert found.took_place == {"a joint moves, rad/s": 0.2, "runs": ["approach"]}
    cell.client.branches["placement"] = "retracted"
    cell.client.devices["robot.joints"] = {"velocities": [0.0, 0.0]}
    assert "a joint moves" in ran(monkeypatch, tmp_path, cell, operator.edited_while_moving).missing("order")
