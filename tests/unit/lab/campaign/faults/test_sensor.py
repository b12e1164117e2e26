"""Rows of a tracker's faults: no motion is accepted with them, one is without them, and a subscriber has seen them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.calibration import read_calibration
from pcmrs.messages import BodyPose, JointState, PoseMessage
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence, NotRun
from pcmrs_lab.campaign.faults import sensor
from pcmrs_lab.campaign.faults.sensor import NOT_AGREED
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.scripted_cell import ScriptedLab
from tests.unit.lab.scripted_client import failed

RATE = 60.0


class Tracked(OperatedCell):
    """A cell whose tracker sends frames of the coil and the reference; a fault changes them.

    Attributes:
        changed: What a fault has changed in the frames of a body.
        believes: The daemon accepts a motion to the body whatever the tracker says.
    """

    def __init__(self, **branches: str) -> None:
        super().__init__(Path("cell1"), **branches)
        self.changed: dict[str, dict[str, Any]] = {}
        self.believes = False
        self.client.refuses["placement.confirm"] = self._refusal
        self.client.refuses["stimulation.fire"] = self._refusal

    def _refusal(self, _: Any) -> str:
        return "pose_stale" if self.changed and not self.believes else ""

    def harm(self, fault: str, **fields: Any) -> None:
        """Lets a fault of the scene change these fields of the frames of its body."""

        def effect(arguments: dict[str, Any]) -> None:
            bodies = [arguments["body"]] if "body" in arguments else ["coil", "body_ref"]
            for body in bodies:
                self.changed.pop(body, None)
                if arguments.get("on", True):
                    self.changed[body] = fields
            if self.client.branches["placement"] == "following" and self.changed:
                self.client.hold()

        self.scene.effects[fault] = effect

    async def send_frames(self) -> None:
        number = 0
        while True:
            number += 1
            at = asyncio.get_running_loop().time()
            for body in ("coil", "body_ref"):
                pose = BodyPose(body=body, frame_number=number, captured=at, sent=at, valid=True)
                for key, handler in list(self.bus.handlers.items()):
                    if key in (f"state/pose/{body}", "state/pose/*"):
                        handler(key, replace(pose, **self.changed.get(body, {})))
            await asyncio.sleep(1.0 / RATE)


def ran(monkeypatch: pytest.MonkeyPatch, folder: Path, cell: Tracked, row: Any) -> Evidence:
    async def with_frames() -> Evidence:
        frames = asyncio.create_task(cell.send_frames())
        try:
            found: Evidence = await row(lab_of(folder, cell))
            return found
        finally:
            frames.cancel()

    return run(monkeypatch, with_frames())


def test_no_motion_is_accepted_while_a_body_is_hidden(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked()
    cell.harm("occlude", valid=False)
    found = ran(monkeypatch, tmp_path, cell, sensor.occluded)
    assert proves(found)
    assert found.response == "confirm refused: pose_stale"
    assert set(found.took_place) == {"occlude coil", "occlude body_ref"}
    assert found.control == {"confirm without the fault": "accepted", "reached": "placed"}


def test_a_motion_that_is_accepted_with_it_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked()
    cell.harm("occlude", valid=False)
    cell.believes = True
    with pytest.raises(Unmet, match="confirm was accepted"):
        ran(monkeypatch, tmp_path, cell, sensor.occluded)


def test_a_body_that_was_never_hidden_is_found_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked()
    with sham(), pytest.raises(Unmet, match="confirm was accepted"):
        ran(monkeypatch, tmp_path, cell, sensor.occluded)
    cell = Tracked()
    cell.harm("occlude")
    with pytest.raises(Unmet, match="occlude"):
        ran(monkeypatch, tmp_path, cell, sensor.occluded)


def test_a_tool_that_follows_is_held(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")
    cell.harm("occlude", valid=False)
    found = ran(monkeypatch, tmp_path, cell, sensor.occluded_while_following)
    assert proves(found)
    assert list(found.control.values()) == ["following"]


def test_a_tool_that_follows_on_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")
    with pytest.raises(Unmet, match="expected state did not come"):
        ran(monkeypatch, tmp_path, cell, sensor.occluded_while_following)


def test_two_faults_of_one_row_keep_their_controls() -> None:
    def evidence(response: str, **seen: int) -> Evidence:
        return Evidence(response, took_place=seen, control={"confirm": "accepted"}, control_kind="without_fault")

    first, second = evidence("refused", a=1), evidence("refused, too", b=2)
    found = sensor._combine(first, second)
    assert found.response == "refused; refused, too"
    assert found.took_place == {"a": 1, "b": 2}
    assert found.control == {"first": first.control, "second": second.control}
    nothing = sensor._combine(first, evidence("refused", b=0))
    assert "b" in nothing.missing("sensor")


def test_a_reference_that_slips_ends_the_registration(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")

    def slip(arguments: dict[str, Any]) -> None:
        moved = arguments["millimetres"]
        cell.scene.patient = PoseMessage(position=(max(moved, 0.0) * 1e-3, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
        if moved > 0.0:
            cell.client.branches |= {"registration": "100", "digitization": "0"}
            cell.client.hold()

    cell.scene.effects["bump_reference"] = slip
    found = ran(monkeypatch, tmp_path, cell, sensor.bumped)
    assert proves(found)
    assert found.took_place["slipped_mm"] == pytest.approx(found.details["millimetres"])


def test_a_slip_that_moved_nothing_proves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")

    def slip(_: dict[str, Any]) -> None:
        cell.client.branches |= {"registration": "100", "digitization": "0"}
        cell.client.hold()

    cell.scene.effects["bump_reference"] = slip
    found = ran(monkeypatch, tmp_path, cell, sensor.bumped)
    assert "slipped_mm" in found.missing("order")


def test_a_push_is_measured_by_the_arm_itself(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")

    def push(arguments: dict[str, Any]) -> None:
        if arguments["force"] > sensor.LIMIT:
            pushed = JointState(captured=0.0, sent=0.0, positions=[0.0], velocities=[0.0], torques=[0.0])
            cell.client.tell("state/joints", replace(pushed, flange_force=(0.0, 0.0, arguments["force"])))
            cell.client.hold("force_limit")

    cell.scene.effects["push_tool"] = push
    found = ran(monkeypatch, tmp_path, cell, sensor.pushed)
    assert proves(found)
    assert found.took_place["most_newtons"] == found.details["newtons"] > sensor.LIMIT


def test_a_pulse_that_is_not_given_alone_shows_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")
    cell.client.answers["stimulation.fire"] = [failed("late", "The frames are late.")]
    with pytest.raises(NotRun, match="No pulse is given without the fault either: late"):
        ran(monkeypatch, tmp_path, cell, sensor.slow_frames_at_pulse)


def test_no_pulse_is_given_while_the_head_dashes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    cell = Tracked(placement="placed")

    def dash(arguments: dict[str, Any]) -> None:
        fast = arguments["millimetres_per_second"] > 0.0
        cell.changed = {"body_ref": {}} if fast else {}
        cell.client.refuses["stimulation.fire"] = "head_moves" if fast else ""

    cell.scene.effects["dash_head"] = dash
    with pytest.raises(Unmet, match="dash_head"):
        ran(monkeypatch, tmp_path, cell, sensor.dashing_head)


class Refusing(ScriptedLab):
    """A lab whose daemons must refuse to start, with this error; and one that starts."""

    def __init__(self, folder: Path, cell: OperatedCell, error: str) -> None:
        super().__init__(folder, cell)
        self.refusals = [(2, error)]


def test_a_tool_definition_must_be_the_agreed_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def start(text: str) -> Evidence:
        lab = Refusing(tmp_path, cell := Tracked(), text)

        async def with_frames() -> Evidence:
            frames = asyncio.create_task(cell.send_frames())
            try:
                return await sensor.wrong_definition(lab.as_lab)
            finally:
                frames.cancel()

        return run(monkeypatch, with_frames())

    found = start(f"coil.rom {NOT_AGREED}")
    assert proves(found)
    with pytest.raises(Unmet, match="Exit status 2: another error"):
        start("another error")
    with sham():
        assert "hash differs" in start(f"coil.rom {NOT_AGREED}").missing("order")


def test_a_calibration_of_the_simulated_cell_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "tool.toml"
    sensor._write_calibration(file, serial="17")
    found = read_calibration(file)
    assert (found.serial, found.kind, found.type) == ("17", "tool", "coil")
    assert 'serial = "17"' in file.read_text()
    assert "0.138" in file.read_text(), "what the row changes by hand is in it"


async def test_digitizing_is_refused_for_the_reason(tmp_path: Path) -> None:
    cell = OperatedCell()
    cell.client.refuses["digitization.digitize_all"] = "calibration_foreign"
    assert await sensor._digitize_with(lab_of(tmp_path, cell), (), "calibration_foreign") == "calibration_foreign"
    with pytest.raises(Unmet, match="calibration_changed"):
        await sensor._digitize_with(lab_of(tmp_path, cell), (), "calibration_changed")
    cell.client.refuses.clear()
    assert await sensor._digitize_with(lab_of(tmp_path, cell), (), "") == "accepted"


@pytest.mark.parametrize("present", [[False, False, False], [False, True]])
def test_a_threshold_ends_as_the_pulses_say(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, present: list[bool]
) -> None:
    cell = Tracked(threshold="idle")
    answers = list(present)

    def pulse(_: Any) -> str:
        answer = answers.pop(0)
        cell.client.results["threshold.pulse"] = {"mep": {"present": answer}, "refusal": "" if answers else "no_mep"}
        if not answers:
            cell.client.branches["threshold"] = "refused"
        return ""

    cell.client.refuses["threshold.pulse"] = pulse
    cell.client.leads["threshold.begin"] = {"threshold": "hunting"}
    work = sensor._estimate_threshold(cell.as_cell)
    if any(present):
        with pytest.raises(Unmet, match="Pulse 2 counts as answered"):
            run(monkeypatch, work)
    else:
        pulses, result = run(monkeypatch, work)
        assert (pulses, result["refusal"]) == (3, "no_mep")


def test_a_muscle_that_never_answers_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = Tracked(threshold="idle")
    cell.client.leads["threshold.begin"] = {"threshold": "hunting"}
    cell.client.results["threshold.pulse"] = {"mep": {"present": False}}
    cell.client.leads["threshold.pulse"] = {"threshold": "refused"}
    with pytest.raises(Unmet, match="No pulse evokes a response without the fault either"):
        run(monkeypatch, sensor._muscle_response(cell.as_cell))
    cell.client.results["threshold.pulse"] = {"mep": {"present": True, "peak": 5.0}}
    assert run(monkeypatch, sensor._muscle_response(cell.as_cell)) == {"present": True, "peak": 5.0}
