"""What the pages for contributors name is there, and a release has the version that the changelog says."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests import ROOT

DECISIONS = sorted((ROOT / "docs" / "adr").glob("0*.md"))
PAGES = [
    *(ROOT / name for name in ("CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "SECURITY.md")),
    ROOT / "docs" / "adr" / "README.md",
    *DECISIONS,
]
IDS = [page.stem for page in PAGES]
NAMED = re.compile(r"`((?:pcmrs|sim|tests|docs|benchmarks|examples|\.ci)/[\w./-]+)`")


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_file_that_is_linked_or_named_exists(page: Path) -> None:
    text = page.read_text()
    linked = [page.parent / target for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)]
    named = [ROOT / name for name in NAMED.findall(text)]
    assert [str(path) for path in linked + named if not path.exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_target_of_make_that_is_named_exists(page: Path) -> None:
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    assert set(re.findall(r"(?:`|^|sudo )make ([a-z]+)", page.read_text(), re.MULTILINE)) <= targets


@pytest.mark.parametrize("page", DECISIONS, ids=lambda page: page.stem)
def test_a_decision_has_its_parts_and_a_row(page: Path) -> None:
    text = page.read_text()
    assert text.startswith(f"# {page.stem[:4]}: ")
    assert re.search(r"^- Status: (accepted|superseded by \[\d{4}\]\(.+\))$", text, re.MULTILINE)
    date = re.search(r"^- Date: (\d{4}-\d\d-\d\d)", text, re.MULTILINE)
    assert date is not None
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences", "Alternatives"]
    rows = (page.parent / "README.md").read_text()
    assert re.search(rf"^\| \[{page.stem[:4]}\]\({page.name}\) \| .+ \| {date[1]} \|$", rows, re.MULTILINE)


def test_decisions_have_numbers_of_their_own() -> None:
    assert len({page.stem[:4] for page in DECISIONS}) == len(DECISIONS)


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A copy of all that is asked before anything is built."""
    (tmp_path / ".ci").mkdir()
    shutil.copy(ROOT / ".ci" / "release", tmp_path / ".ci")
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    program = tmp_path / ".venv" / "bin" / "hatchling"
    program.write_text("#!/bin/sh\necho 1.2.0\n")
    program.chmod(0o755)
    return tmp_path


@pytest.mark.parametrize(
    ("heading", "said"),
    [
        ("1.1.0, 2026-01-31", "the version is 1.2.0, but the newest heading of CHANGELOG.md is '## 1.1.0, 2026-01-31'"),
        ("1.2.0, 2026-01-31", "changes that are not committed"),
        ("1.2.0", "changes that are not committed"),
    ],
)
def test_release_needs_the_changelog_version_and_a_clean_tree(release: Path, heading: str, said: str) -> None:
    (release / "CHANGELOG.md").write_text(f"# Changelog\n\n## {heading}\n\n## 1.2.0, 2025-12-31\n")
    subprocess.run(["git", "init", "--quiet", str(release)], check=True)
    ended = subprocess.run([release / ".ci" / "release"], capture_output=True, text=True, check=False)
    assert (ended.returncode, said in ended.stderr) == (1, True), ended.stderr
    assert not (release / "dist").exists()
