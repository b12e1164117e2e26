"""The hosted workflows run what is run by hand, and every part of a nightly run."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import yaml

from tests import ROOT
from tests.nightly.nightly_parts import chosen, parts

WORKFLOWS = ROOT / ".github" / "workflows"


def read(name: str) -> Any:
    return yaml.safe_load((WORKFLOWS / name).read_text())


def test_every_part_is_run_each_night() -> None:
    """The matrix is what the runner answers to the command in the workflow."""
    told = read("nightly.yml")
    asking, running = told["jobs"]["parts"], told["jobs"]["part"]
    (step,) = (step for step in asking["steps"] if step.get("id") == "names")

    assert told[True]["schedule"]  # YAML reads `on` so
    assert asking["outputs"]["names"] == "${{ steps.names.outputs.names }}"
    assert running["strategy"]["matrix"]["name"] == "${{ fromJSON(needs.parts.outputs.names) }}"
    assert any("make nightly PART=${{ matrix.name }}" in step.get("run", "") for step in running["steps"])
    assert "-m tests.nightly.run --names" in step["run"]
    command = [sys.executable, "-m", "tests.nightly.run", "--names"]
    names = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    run = [part.name for name in names for part in chosen(name)]
    assert run == [part.name for part in parts()], "each once"
    for maker in (part for part in parts() if part.makes):
        assert maker.name not in names, "the parts that need its file would not find it on another machine"


def test_a_change_passes_what_it_passes_by_hand() -> None:
    told = read("ci.yml")

    assert any(".ci/run" in step.get("run", "") for step in told["jobs"]["run"]["steps"])


def test_nothing_is_repeated_by_ci() -> None:
    for file in (ROOT / ".ci" / "run", ROOT / "Makefile", *WORKFLOWS.iterdir()):
        for word in ("again", "--last-failed", "--lf", "--reruns", "retry"):
            lines = [line for line in file.read_text().splitlines() if word in line.split() or f".ci/{word}" in line]
            assert [line for line in lines if "## " not in line] == [], file


def test_the_lock_is_audited_each_night_as_documented() -> None:
    (step,) = (step for step in read("nightly.yml")["jobs"]["audit"]["steps"] if "run" in step)

    assert "pip-audit" in step["run"]
    assert step["run"] in (ROOT / "docs" / "supply.md").read_text().splitlines()
