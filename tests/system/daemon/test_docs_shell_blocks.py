"""Every shell block of the README, the tutorial and the pages for a first planner and device does what it shows."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pcmrs.client import Client
from pcmrs.dispatcher.stops import YOUNG
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import reset_cell
from tests import ROOT
from tests.system.daemon.shell_pages import SERVE, Shown, ShownPage, User

ELSEWHERE = {
    "make install": "installs; done in the tests' environment",
    "source .venv/bin/activate": "the tests' environment is another",
    "make demo": "installs; .ci/wheel runs the demo",
    "make test": "runs this test",
}
"""Commands that are not run here, and why."""
RELEASES = ("pcmrs call robot.acknowledge",)
"""Commands that acknowledge a Stop without naming it."""
OTHER_NUMBER = {"execute_motionxx_#1;": "execute_motionxx_#2;", "1_rejected_placement_pl": "2_rejected_placement_pl"}
"""The README has used the number of a command on the page for a planner: here, the same daemon receives both."""


@pytest.fixture(scope="module")
def neighbour(tmp_path_factory: pytest.TempPathFactory) -> Iterator[User]:
    """A user whose daemon continues from page to page."""
    with User(_home(tmp_path_factory.mktemp("shared")), daemon_lasts=True) as user:
        user.types(Shown(SERVE))
        yield user
        user.interrupts(SERVE)
        assert "Traceback" not in user.complaints(SERVE)


@pytest.mark.timeout(400)  # of a machine that does much else
@pytest.mark.parametrize("name", ["README.md", "docs/tutorial.md", "docs/new-planner.md"])
def test_every_shell_block_does_what_it_shows(name: str, neighbour: User) -> None:
    asyncio.run(_reset(neighbour.endpoint))
    _type_all(name, neighbour)


@pytest.mark.timeout(400)
def test_the_blocks_of_the_page_for_a_device_do_what_they_show(tmp_path: Path) -> None:
    """With a daemon that has the device."""
    with User(_home(tmp_path)) as user:
        _type_all("docs/new-device.md", user)


def _home(folder: Path) -> Path:
    home = folder / "home"
    home.mkdir()
    (home / "examples").symlink_to(ROOT / "examples")
    return home


async def _reset(endpoint: str) -> None:
    """Every page begins with a new daemon."""
    async with Client.connect(endpoint) as client:
        await reset_cell(client)


def _type_all(name: str, user: User) -> None:
    page = ShownPage(ROOT / name, _own(user))
    for file, text in page.files().items():
        (user.folder / file).write_text(text)
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
    install = "uv pip install --quiet --offline --no-deps --no-build-isolation"
    install += f" --python {sys.executable} --target {user.packages} ."
    return {
        "8057": str(user.planner_port),
        "8081": str(user.console_port),
        "9000": str(free_port()),
        "pcmrs-serve --config cell.toml": "pcmrs-serve --config cell.toml --set cell.rate=1",
        "pip install --no-deps .": install,
        **OTHER_NUMBER,
    }
