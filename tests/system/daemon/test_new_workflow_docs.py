"""``docs/new-workflow.md`` done literally, as a new user does it: its files written, its commands run in order."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import ROOT
from tests.system.daemon.shell_pages import ShownPage, User, written_home

PAGE = ShownPage(ROOT / "docs" / "new-workflow.md")


def test_the_page_and_the_example_are_the_same_files() -> None:
    folder = ROOT / "examples" / "biopsy"
    written = PAGE.files()
    for name in ("biopsy.toml", "biopsy.py", "landmarks.json"):
        assert written[name] == (folder / name).read_text()


@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_a_new_user_gets_what_the_page_shows(tmp_path: Path) -> None:
    with User(written_home(tmp_path, PAGE)) as user:
        for shown in PAGE.commands():
            printed, _ = user.types(shown)
            assert shown.matches(printed), f"$ {shown.command}\n{printed}"
        assert user.daemons_started == 2
