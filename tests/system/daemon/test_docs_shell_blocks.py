"""Every shell block of the README, the tutorial and the pages for a first planner and device does what it shows."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from pcmrs.dispatcher.stops import YOUNG
from pcmrs.testing.daemon import free_port
from tests import ROOT
from tests.system.daemon.shell_pages import Shown, ShownPage, User

ELSEWHERE = {
    "make install": "installs; done in the tests' environment",
    "source .venv/bin/activate": "the tests' environment is another",
    "make demo": "installs; .ci/wheel runs the demo",
    "make test": "runs this test",
}
"""Commands that are not run here, and why."""
RELEASES = ("pcmrs call robot.acknowledge",)
"""Commands that acknowledge a Stop without naming it."""


@pytest.mark.timeout(400)  # of a machine that does much else
@pytest.mark.parametrize("name", ["README.md", "docs/tutorial.md", "docs/new-planner.md", "docs/new-device.md"])
def test_every_shell_block_does_what_it_shows(name: str, tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    (home / "examples").symlink_to(ROOT / "examples")
    with User(home) as user:
        page = ShownPage(ROOT / name, _own(user))
        for file, text in page.files().items():
            (home / file).write_text(text)
        if not any(shown.program for shown in page.commands()):
            user.types(Shown("pcmrs-serve", "…ready"))  # the page says that it runs
        for shown in page.commands():
            if shown.command not in ELSEWHERE:
                if shown.command in RELEASES:
                    time.sleep(YOUNG)  # who types that has read what was stopped: a younger Stop has to be named
                printed, status = user.types(shown)
                assert shown.matches(printed), f"$ {shown.command}\n{printed}"
                complaints = user.complaints("shell")
                assert status == 0 or shown.output, f"$ {shown.command}: {status}\n{printed}\n{complaints}"
        for program in ("shell", *user.ended()):
            assert user.printed(program), program
            assert "Traceback" not in user.complaints(program), user.complaints(program)


def test_shown_commands_are_found_and_compared() -> None:
    commands = list(ShownPage(ROOT / "docs" / "tutorial.md").commands())

    assert {"pcmrs-serve", "pcmrs watch", "pcmrs console"} <= {shown.program for shown in commands}
    assert set(ELSEWHERE) <= {shown.command for name in ("README.md", "docs/tutorial.md") for shown in _commands(name)}
    (stop,) = [shown for shown in commands if shown.command == "pcmrs stop"]
    hint = "stopped, and latched until it is acknowledged: pcmrs call robot.acknowledge '{\"stop\": 1000001}'\n"
    assert stop.matches(hint)
    assert not stop.matches("stopped")


def _commands(name: str) -> list[Shown]:
    return list(ShownPage(ROOT / name).commands())


def _own(user: User) -> dict[str, str]:
    """What a page says in place of what the test's cell has."""
    install = f"pip install --quiet --no-index --no-deps --no-build-isolation --target {user.packages} ."
    return {
        "8057": str(user.planner_port),
        "8081": str(user.console_port),
        "9000": str(free_port()),
        "tracker.driver=lab_tracker": "tracker.driver=lab_tracker --set cell.rate=1",
        "pip install --no-deps .": install,
    }
