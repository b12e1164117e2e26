"""`pcmrs placements` on folders, journals and pose logs, from the outside."""

from __future__ import annotations

import asyncio
import codecs
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.clock import SystemClock
from pcmrs.gateway.pose_files import placement_text, sample_rows
from pcmrs.gateway.tracked_poses import TrackedPoses
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, Command, Verdict
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.spatial import Transform

ERRORS_MM = np.array(((0.3, 0.0, 0.4), (0.0, 0.0, -1.0), (2.0, 0.0, 0.0)))
ANGLES_DEG = (0.1, 0.2, 0.6)
PNG = b"\x89PNG\r\n\x1a\n"


def _run(*words: str) -> Result:
    return CliRunner().invoke(main, ["placements", *words])


def _report(*words: str) -> dict[str, Any]:
    ended = _run(*words, "--json")
    assert ended.exit_code == 0, ended.stderr
    report: dict[str, Any] = json.loads(ended.stdout)
    return report


def _trials(standoff: float) -> list[tuple[Transform, Transform]]:
    """Planned and measured poses with `ERRORS_MM` and `ANGLES_DEG` around the standoff (m)."""
    trials = []
    for number, (error_mm, angle_deg) in enumerate(zip(ERRORS_MM, ANGLES_DEG, strict=True)):
        planned = Transform.from_rotvec((0.01 * number, 0.05, 0.1), (0.4, -1.0, 0.1 * number))
        turned = Transform.from_rotvec(np.zeros(3), (0.0, np.radians(angle_deg), 0.0))
        in_tool = Transform(np.eye(3), error_mm / 1000.0 + (0.0, 0.0, standoff))
        trials.append((planned, planned @ turned @ in_tool))
    return trials


def _folder(folder: Path, standoff: float = 0.010) -> str:
    for number, (planned, measured) in enumerate(_trials(standoff), start=1):
        (folder / f"placement_{number}.yaml").write_text(placement_text(planned, measured))
    return str(folder)


def _check_errors(report: dict[str, Any]) -> None:
    for trial, error_mm, angle_deg in zip(report["trials"], ERRORS_MM, ANGLES_DEG, strict=True):
        assert trial["error_vector_mm"] == pytest.approx(error_mm, abs=1e-9)
        assert trial["translation_error_mm"] == pytest.approx(float(np.linalg.norm(error_mm)))
        assert trial["rotation_error_deg"] == pytest.approx(angle_deg)
    summary = report["translation_error_mm"]
    sd = float(np.std([0.5, 1.0, 2.0], ddof=1))
    assert summary == {"mean": pytest.approx(3.5 / 3), "sd": pytest.approx(sd), "max": pytest.approx(2.0)}
    assert report["rotation_error_deg"]["mean"] == pytest.approx(0.3)


def test_saved_placements_are_evaluated_at_the_lab_standoff(tmp_path: Path) -> None:
    _check_errors(_report(_folder(tmp_path)))


def test_another_standoff_can_be_named(tmp_path: Path) -> None:
    _check_errors(_report(_folder(tmp_path, standoff=0.07), "--standoff-mm", "70"))


def test_the_table_has_every_trial_and_the_picture_is_a_png(tmp_path: Path) -> None:
    plot = tmp_path / "errors.png"
    ended = _run(_folder(tmp_path), "--plot", str(plot))
    assert ended.exit_code == 0
    for shown in ("placement_1", "placement_3", "0.5000", "0.6000", "0.7638"):
        assert shown in ended.stdout
    assert plot.read_bytes().startswith(PNG)


def test_brackets_in_a_name_are_shown_as_they_are(tmp_path: Path) -> None:
    file = (Path(_folder(tmp_path)) / "placement_2.yaml").rename(tmp_path / "trial[bold].yaml")
    assert "1  trial[bold] " in _run(str(file)).stdout


def test_one_placement_has_no_standard_deviation_but_a_picture(tmp_path: Path) -> None:
    file = Path(_folder(tmp_path)) / "placement_2.yaml"
    report = _report(str(file), "--plot", str(tmp_path / "one.png"))
    assert report["translation_error_mm"] == {"mean": pytest.approx(1.0), "sd": None, "max": pytest.approx(1.0)}
    assert (tmp_path / "one.png").read_bytes().startswith(PNG)


def _as_result(pose: Transform) -> dict[str, Any]:
    return {"position": pose.translation.tolist(), "quat_xyzw": pose.quat_xyzw.tolist()}


def _journal(path: Path, rows: list[tuple[str, str, dict[str, Any]]]) -> str:
    """A journal with one row of (operation, decision, result) each."""

    async def write() -> None:
        journal = Journal.open(path, durable=False)
        recorder = JournalRecorder(journal, SystemClock(), "session", BlueprintTag(id="ratms", version="1", hash="0"))
        for number, (operation, decision, result) in enumerate(rows):
            command = Command(id=f"c{number}", branch="placement", operation=operation, source="bus:local")
            named = {"id": command.id, "branch": "placement", "operation": operation}
            verdict = Verdict(**named, decision=decision, state="placed", sequence=1, result=result)  # type: ignore[arg-type]
            await recorder.decision(command, verdict, {"placement": "placed"}, {}, with_intent=True)
        await journal.close()

    asyncio.run(write())
    return str(path)


def _confirmed(standoff: float, **more: Any) -> list[tuple[str, str, dict[str, Any]]]:
    return [
        ("confirm", "accepted", {"planned": _as_result(planned), "measured": _as_result(measured), **more})
        for planned, measured in _trials(standoff)
    ]


def test_the_accepted_confirms_of_a_journal_are_evaluated(tmp_path: Path) -> None:
    rows = [("approach", "accepted", {}), *_confirmed(0.0), ("confirm", "failed", {"correction_mm": 9.0})]
    report = _report(_journal(tmp_path / "ratms.sqlite", rows))
    _check_errors(report)
    assert [trial["standoff_mm"] for trial in report["trials"]] == [0.0] * 3


def test_the_offset_on_record_counts_unless_another_is_named(tmp_path: Path) -> None:
    path = _journal(tmp_path / "ratms.sqlite", _confirmed(0.010, confirm_offset=0.010))
    _check_errors(_report(path))
    path = _journal(tmp_path / "other.sqlite", _confirmed(0.020, confirm_offset=0.010))
    _check_errors(_report(path, "--standoff-mm", "20"))


def _pose_log(folder: Path, samples: int = 20) -> Path:
    rng = np.random.default_rng(4)
    tracker_from_body = Transform.from_rotvec((0.1, 0.0, -0.9), (1.0, 0.2, 0.0))
    text = ""
    for _ in range(samples):
        tracker_from_tool = Transform.from_rotvec((0.03, -0.1, -0.9) + rng.normal(size=3) * 3e-5, (0.2, 1.2, 0.0))
        body_from_tool = tracker_from_body.inverse() @ tracker_from_tool
        text += sample_rows(TrackedPoses(body_from_tool, tracker_from_body, tracker_from_tool))
    path = folder / "poses_1.csv"
    path.write_text(text)
    return path


def test_pose_log_is_recognised_by_its_content(tmp_path: Path) -> None:
    path = _pose_log(tmp_path).rename(tmp_path / "log.txt")
    plot = tmp_path / "log.png"
    report = _report(str(path), "--plot", str(plot))
    assert report["samples"] == report["compared"] == 20
    tracks = {track["name"]: track for track in report["tracks"]}
    assert tracks["pol_body"]["frozen"] == 19
    assert tracks["pol_body"]["jitter_mm"] is None
    assert 0.01 < max(tracks["pol_tool"]["jitter_mm"]) < 0.06
    assert report["max_deviation_mm"] < 0.005  # six decimals of quaternions at a meter
    assert plot.read_bytes().startswith(PNG)


def test_a_pose_log_with_gaps_is_shown(tmp_path: Path) -> None:
    path = _pose_log(tmp_path)
    kept = [line for line in path.read_text().splitlines() if not line.startswith("pol_tool")]
    path.write_text("\n".join(kept))
    ended = _run(str(path), "--plot", str(tmp_path / "gaps.png"))
    assert ended.exit_code == 0
    assert "No sample has all three rows" in ended.stdout
    assert "frozen" in ended.stdout


def _refused(*words: str, status: int = 5) -> str:
    ended = _run(*words)
    assert ended.exit_code == status
    assert isinstance(ended.exception, SystemExit)  # anything else would be a traceback
    assert ended.stdout == ""
    return ended.stderr


def test_unreadable_file_is_named(tmp_path: Path) -> None:
    folder = Path(_folder(tmp_path))
    (folder / "placement_2.yaml").write_text("MEASURED_POSE: 5")
    said = _refused(str(folder))
    assert "placement_2.yaml" in said
    assert "placement_1.yaml" not in said
    assert "nowhere" in _refused(str(tmp_path / "nowhere"))


def test_a_journal_without_placements_is_refused(tmp_path: Path) -> None:
    path = _journal(tmp_path / "ratms.sqlite", [("approach", "accepted", {})])
    assert "no accepted placement.confirm" in _refused(path)
    path = _journal(tmp_path / "old.sqlite", [("confirm", "accepted", {"measured": "here"})])
    assert "row 2" in _refused(path)
    (tmp_path / "damaged.sqlite").write_bytes(b"SQLite format 3\0" + bytes(200))
    assert "damaged.sqlite" in _refused(str(tmp_path / "damaged.sqlite"))


def test_a_standoff_of_a_pose_log_is_a_usage_error(tmp_path: Path) -> None:
    assert "--standoff-mm" in _refused(str(_pose_log(tmp_path)), "--standoff-mm", "10", status=2)


def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    ended = _run(_folder(tmp_path), "--plot", str(tmp_path / "none" / "errors.png"))
    assert ended.exit_code == 2
    assert "errors.png" in ended.stderr


def test_a_folder_that_is_not_there_is_found_before_the_work(tmp_path: Path) -> None:
    ended = _run(str(tmp_path / "none.yaml"), "--plot", str(tmp_path / "none" / "errors.png"))
    assert "create it first" in ended.stderr  # and not that none.yaml is missing


@pytest.mark.parametrize("standoff", ["nan", "inf", "2000"])
def test_a_standoff_must_be_one(standoff: str, tmp_path: Path) -> None:
    assert "--standoff-mm" in _refused(_folder(tmp_path), "--standoff-mm", standoff, status=2)


def test_a_byte_order_mark_before_a_pose_log_is_passed_over(tmp_path: Path) -> None:
    log = _pose_log(tmp_path)
    plain = _report(str(log))
    log.write_bytes(codecs.BOM_UTF8 + log.read_bytes())
    assert _report(str(log)) == plain


def test_file_of_another_kind_is_refused_with_the_known_kinds(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("name,x_mm,y_mm,z_mm\n")
    assert "points.csv is neither a saved placement (.yaml, .yml) nor a journal nor a pose log" in _refused(
        str(tmp_path / "points.csv")
    )


def test_a_terminal_without_a_degree_sign_gets_a_question_mark(tmp_path: Path) -> None:
    ended = CliRunner(charset="ascii").invoke(main, ["placements", _folder(tmp_path)])
    assert ended.exit_code == 0
    assert "rotation error, ?" in ended.stdout
