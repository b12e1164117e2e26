"""`pcmrs register` from files to verdict, exit status and picture."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.formats.lab_yaml import lab_pose
from pcmrs.formats.reading import read_yaml
from pcmrs.spatial import Floats, Transform, distance, rotation_angle
from tests import ROOT

NAMES = ("nasion", "nose_tip", "left_canthus", "right_canthus", "left_tragus", "right_tragus")
PLANNED = np.array([(4, 86, 40), (4, 103, -8), (-46, 69, 35), (54, 69, 36), (-79, -8, 19), (87, -8, 20)]) / 1000.0
TRUTH = Transform.from_rotvec((0.1, -0.2, 0.05), (0.3, 2.0, -0.7))
WOBBLE = np.random.default_rng(5).normal(0.0, 1e-3, PLANNED.shape)


def write(path: Path, points: Floats, names: tuple[str, ...] = NAMES) -> str:
    rows = [f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(names, points.tolist(), strict=True)]
    path.write_text("\n".join(["name,x_m,y_m,z_m", *rows]) + "\n")
    return str(path)


def register(folder: Path, digitized: Floats, *options: str, planned: Floats = PLANNED) -> Result:
    names = NAMES[: len(planned)]
    files = write(folder / "plan.csv", planned, names), write(folder / "digitized.csv", digitized, names)
    return CliRunner().invoke(main, ["register", *files, *options])


def test_good_registration_is_accepted_and_reported_in_full(tmp_path: Path) -> None:
    output = tmp_path / "reg.yaml"
    ended = register(tmp_path, TRUTH @ PLANNED + WOBBLE, "--target", "-0.03,0,0.11", "-o", str(output))
    assert (ended.exit_code, ended.stderr) == (0, "")
    assert ended.stdout.startswith("accepted\n6 landmarks, paired by name\n")
    for part in (*NAMES, "quaternion w x y z", "mean ", "rms ", "predicted TRE", "at the target", "residual_too_large"):
        assert part in ended.stdout
    found = lab_pose(read_yaml(output))
    assert distance(found, TRUTH) < 0.003
    assert rotation_angle(found, TRUTH) < 0.05


def test_json_holds_the_same_numbers(tmp_path: Path) -> None:
    ended = register(tmp_path, TRUTH @ PLANNED + WOBBLE, "--json")
    said = json.loads(ended.stdout)
    assert said["accepted"] is True
    assert said["refusal"] is None
    found = Transform.from_matrix(said["body_ref_from_image"])
    residuals = np.linalg.norm(found @ PLANNED - (TRUTH @ PLANNED + WOBBLE), axis=1)
    np.testing.assert_allclose(said["residuals"], residuals, atol=1e-12)
    assert said["mean"] == pytest.approx(residuals.mean())
    assert said["rms"] == pytest.approx(np.sqrt(np.mean(residuals**2)))
    np.testing.assert_allclose(Transform.from_quat_wxyz(said["translation"], said["quat_wxyz"]).matrix, found.matrix)
    assert {gate["name"] for gate in said["gates"]} >= {"wrong_unit", "residual_too_large", "tre_too_large"}
    assert all({"value", "limit", "text"} <= set(gate) for gate in said["gates"])


def _with(index: int, shift: tuple[float, float, float]) -> Floats:
    points = TRUTH @ PLANNED + WOBBLE
    points[index] += shift
    return points


def _refused(said: dict[str, object]) -> object:
    refusal = said["refusal"]
    assert isinstance(refusal, dict)
    return refusal["code"]


@pytest.mark.parametrize(
    ("digitized", "options", "code"),
    [
        (_with(3, (0.0, 0.03, 0.0)), (), "landmark_outlier"),
        ((TRUTH @ PLANNED + WOBBLE) * 1000.0, (), "wrong_unit"),
        ((TRUTH @ PLANNED + WOBBLE) * (-1.0, 1.0, 1.0), (), "mirrored"),
        ((TRUTH @ PLANNED + WOBBLE)[[1, 0, 2, 3, 4, 5]], (), "swapped_landmarks"),
        (TRUTH @ PLANNED + WOBBLE, ("--limit-mm", "0.5"), "residual_too_large"),
        (TRUTH @ PLANNED + WOBBLE, ("--tre-limit-mm", "0.2"), "tre_too_large"),
        (TRUTH @ PLANNED + WOBBLE, ("--target", "0,-0.9,0.5", "--workflow", "femoroplasty"), "tre_too_large"),
        (TRUTH @ PLANNED + 4 * WOBBLE, ("--sigma-mm", "0.1"), "landmark_outlier"),
    ],
)
def test_a_bad_registration_is_refused_by_its_gate(
    digitized: Floats, options: tuple[str, ...], code: str, tmp_path: Path
) -> None:
    ended = register(tmp_path, digitized, "--json", *options)
    assert ended.exit_code == 1
    assert _refused(json.loads(ended.stdout)) == code
    told = register(tmp_path, digitized, *options)
    assert told.exit_code == 1
    assert told.stdout.startswith("REFUSED: ")
    assert f"REFUSED {code}" in told.stdout


def test_a_refused_registration_is_not_written(tmp_path: Path) -> None:
    output = tmp_path / "reg.yaml"
    ended = register(tmp_path, _with(3, (0.0, 0.03, 0.0)), "-o", str(output))
    assert ended.exit_code == 1
    assert not output.exists()
    assert f"{output} is not written" in ended.stderr


def test_collinear_landmarks_are_refused_with_singular_values(tmp_path: Path) -> None:
    line = np.outer(np.arange(4.0), (0.01, 0.02, 0.03))
    ended = register(tmp_path, TRUTH @ line, "--json", planned=line)
    assert ended.exit_code == 1
    said = json.loads(ended.stdout)
    assert said["accepted"] is False
    assert len(said["refusal"]["singular_values"]) == 3
    assert re.match(rf"{re.escape(str(tmp_path))}.*: The fixed points lie on a line", said["refusal"]["text"])


def test_pairing_by_order_is_reported(tmp_path: Path) -> None:
    plan = write(tmp_path / "a.csv", PLANNED)
    digitized = write(tmp_path / "b.csv", TRUTH @ PLANNED, tuple(f"d{index}" for index in range(6)))
    ended = CliRunner().invoke(main, ["register", plan, digitized])
    assert ended.exit_code == 0
    assert "paired by order" in ended.stdout


def test_the_example_plan_of_the_phantom_is_read(tmp_path: Path) -> None:
    example = ROOT / "examples" / "ratms_plan.json"
    landmarks = json.loads(example.read_text())["landmarks"]
    points = TRUTH @ np.array([landmark["position"] for landmark in landmarks])
    digitized = write(tmp_path / "d.csv", points, tuple(landmark["name"] for landmark in landmarks))
    assert CliRunner().invoke(main, ["register", str(example), digitized]).exit_code == 0


@pytest.mark.parametrize("digitized", [TRUTH @ PLANNED + WOBBLE, _with(3, (0.0, 0.03, 0.0))])
def test_the_picture_is_a_png(digitized: Floats, tmp_path: Path) -> None:
    register(tmp_path, digitized, "--plot", str(tmp_path / "a.png"))
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_registration_there_is_no_picture(tmp_path: Path) -> None:
    ended = register(tmp_path, TRUTH @ PLANNED * 1000.0, "--plot", str(tmp_path / "a.png"))
    assert ended.exit_code == 1
    assert not (tmp_path / "a.png").exists()
    assert "a.png is not written" in ended.stderr


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--target", "30,0,110"), "millimetres"),
        (("--target", "0.1,0"), "three numbers"),
        (("--target", "nan,0,0"), "metres"),
        (("--limit-mm", "0"), "--limit-mm"),
        (("--sigma-mm", "nan"), "nan is not finite"),
        (("--tre-limit-mm", "inf"), "inf is not finite"),
        (("--plot", "no_such_folder/reg.png"), "no folder no_such_folder"),
        (("-o", "."), "is a directory"),
        (("--workflow", "biopsy"), "biopsy"),
    ],
)
def test_senseless_options_are_usage_errors(options: tuple[str, ...], text: str, tmp_path: Path) -> None:
    ended = register(tmp_path, TRUTH @ PLANNED, *options)
    assert ended.exit_code == 2
    assert text in ended.stderr


def test_input_file_is_not_overwritten(tmp_path: Path) -> None:
    plan = write(tmp_path / "plan.csv", PLANNED)
    before = Path(plan).read_text()
    ended = CliRunner().invoke(main, ["register", plan, plan, "-o", plan])
    assert (ended.exit_code, Path(plan).read_text()) == (2, before)
    assert "would be overwritten" in ended.stderr


def test_unreadable_files_end_with_2_and_one_line(tmp_path: Path) -> None:
    plan = write(tmp_path / "plan.csv", PLANNED)
    shorter = write(tmp_path / "shorter.csv", PLANNED[:5], NAMES[:5])
    for digitized, text in ((str(tmp_path / "none.csv"), "none.csv"), (shorter, "6 planned landmarks but 5")):
        ended = CliRunner().invoke(main, ["register", plan, digitized])
        assert ended.exit_code == 5
        assert ended.stdout == ""
        (line,) = ended.stderr.splitlines()
        assert text in line


def test_a_result_that_cannot_be_written_ends_with_2(tmp_path: Path) -> None:
    for option in ("-o", "--plot"):
        ended = register(tmp_path, TRUTH @ PLANNED, option, str(tmp_path / "nowhere" / "file"))
        assert ended.exit_code == 2
        assert "nowhere" in ended.stderr
        assert "Traceback" not in ended.stderr
