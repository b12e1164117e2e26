"""Planning in a real browser: targets, grids, trajectories and files, and files that are none."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import ROOT
from tests.system.console.consoles import CHROMIUM, browser, console, running_cell
from tests.system.console.test_browser import PATIENT, Operator

pytest.importorskip("playwright")
nibabel = pytest.importorskip("nibabel")

pytestmark = [
    pytest.mark.timeout(600),
    pytest.mark.skipif(not CHROMIUM, reason="Chromium is not installed: apt-get install chromium"),
]
PLAN: dict[str, Any] = json.loads((ROOT / "examples" / "ratms_plan.json").read_text())


class Planner(Operator):
    """Whoever plans."""

    def give(self, file: Path, role: str = "") -> None:
        """Chooses a file, as by the dialog of the browser."""
        if role:
            self.at("file-role").get_by_text(role, exact=True).click()
        self.at("upload").locator("input[type=file]").set_input_files(file)

    def choose(self, kind: str) -> None:
        self.at("mode").get_by_text(kind, exact=True).click()


def markups(path: Path, space: str) -> Path:
    """The phantom's landmarks, in RAS and mm, declared as in `space`."""
    points = [
        {"label": each["name"], "position": [1000.0 * value for value in each["position"]], "positionStatus": "defined"}
        for each in PLAN["landmarks"]
    ]
    markup = {"type": "Fiducial", "coordinateSystem": space, "coordinateUnits": "mm", "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup]}))
    return path


def ball(path: Path) -> Path:
    """A volume with a ball of 80 mm radius about the image's origin."""
    points = np.stack(np.meshgrid(*[np.arange(60.0)] * 3, indexing="ij"), axis=-1) * 3.0 - 90.0
    values = 1000.0 * np.clip(0.5 - (np.linalg.norm(points, axis=-1) - 80.0) / 3.0, 0.0, 1.0)
    grid = np.diag((3.0, 3.0, 3.0, 1.0))
    grid[:3, 3] = -90.0
    nibabel.save(nibabel.Nifti1Image(values.astype(np.int16), grid), path)
    return path


def bomb(path: Path) -> Path:
    header = nibabel.Nifti1Header()
    header["dim"][:4], header["pixdim"][1:4], header["sform_code"], header["vox_offset"] = (
        (3, 1024, 1024, 1024),
        1,
        1,
        352,
    )
    path.write_bytes(gzip.compress(header.binaryblock + bytes(1000)))
    return path


@pytest.mark.browser
def test_files_are_planned_on_or_refused_and_the_page_stays_up(tmp_path: Path) -> None:
    broken, huge = tmp_path / "broken.stl", tmp_path / "huge.nii"
    broken.write_bytes(b"solid nonsense")
    with huge.open("wb") as stream:
        stream.truncate(2 * 10**9)
    with running_cell(tmp_path, *PATIENT) as address, console(*address) as (_, url), browser(url) as page:
        planner = Planner(page)
        planner.open("planning")
        planner.at("files").click()
        planner.give(broken)
        planner.shows("upload-result", "broken.stl")
        planner.give(huge)
        planner.shows("upload-result", "Too large")
        planner.give(bomb(tmp_path / "bomb.nii.gz"))
        planner.shows("upload-result", "1074 million; the limit is 200 million")
        planner.give(markups(tmp_path / "wrong.mrk.json", "LPS"), "Landmarks")
        planner.shows("upload-result", "from the surface")
        planner.expect(planner.at("landmarks")).to_be_empty()
        planner.give(markups(tmp_path / "right.mrk.json", "RAS"))
        planner.shows("landmarks", "nose_tip: 4.0 103.5 -7.8 mm")
        planner.shows("check", "would accept it")
        planner.press("send-landmarks")
        planner.give(ball(tmp_path / "ball.nii.gz"), "Surface")
        planner.shows("upload-result", "160 × 160 × 160 mm")
        planner.shows("own-surface", "Only this page has this surface")
        planner.choose("Tool pose")
        planner.at("tool-point").fill("0 0 95")
        planner.press("place-tool")
        planner.shows("tool-pose", "0.0 0.0 79.9")
        planner.press("cell-surface")
        planner.expect(planner.at("own-surface")).to_be_hidden()
        planner.at("target-point").fill("4 -12 120")
        planner.press("project-target")
        planner.shows("tool-pose", "target 2")
        planner.shows("check", "not known before a registration")
        planner.press("nudge-ArrowUp")
        planner.open("workflow")
        planner.in_state("registration", "100")


@pytest.mark.nightly
def test_a_plan_is_validated_while_it_is_edited(tmp_path: Path) -> None:
    with running_cell(tmp_path, *PATIENT) as address, console(*address) as (_, url), browser(url) as page:
        planner = Planner(page)
        planner.to_standoff()
        planner.open("planning")
        planner.shows("check", "✓ Reachable")
        planner.at("tool-point").fill("0 20 -73")  # from below
        planner.press("place-tool")
        planner.shows("check", "✗")


@pytest.mark.nightly
def test_a_grid_is_laid_and_planned(tmp_path: Path) -> None:
    settings = (*PATIENT, "workflow=grid_mapping")
    with running_cell(tmp_path, *settings) as address, console(*address) as (_, url), browser(url) as page:
        planner = Planner(page)
        planner.open("planning")
        planner.choose("Tool pose")
        planner.at("tool-point").fill("4 -12 143")
        planner.press("place-tool")
        planner.choose("Grid")
        planner.at("grid-rows").fill("2")
        planner.press("lay-grid")
        planner.shows("grid", "6 points")
        planner.shows("check", "maps 9 points")
        planner.at("grid-rows").fill("3")
        planner.press("lay-grid")
        planner.shows("check", "not known before a registration")
        planner.press("send-grid")
        planner.open("workflow")
        planner.in_state("mapping", "ready")


@pytest.mark.nightly
def test_a_trajectory_is_planned(tmp_path: Path) -> None:
    settings = (*PATIENT, "workflow=femoroplasty")
    with running_cell(tmp_path, *settings) as address, console(*address) as (_, url), browser(url) as page:
        planner = Planner(page)
        planner.open("planning")
        planner.choose("Trajectory")
        for point in ("117 0 0", "112 0 1"):
            planner.at("trajectory-point").fill(point)
            planner.press("place-trajectory")
        planner.shows("trajectory", "5.1 mm long")
        planner.at("trajectory-point").fill("116 0 0")
        planner.press("place-trajectory")
        planner.shows("check", "a trajectory has 5 to 200 mm")
        planner.at("trajectory-point").fill("40 20 15")
        planner.press("place-trajectory")
        planner.shows("check", "not known before a registration")
        planner.press("send-trajectory")
        planner.open("workflow")
        planner.in_state("toolplan", "1")
