"""Every command of ours that the pages on deployment show exists, with its options; so does every file they name."""

import re
import shlex
from pathlib import Path

import click
import pytest

from pcmrs.cli import main
from pcmrs.cli.router import router
from pcmrs.console.settings import HOST, TOKEN
from pcmrs.settings import Settings
from tests import ROOT

DEPLOY = ROOT / "deploy"
PAGES = sorted(DEPLOY.rglob("README.md"))


def shown(page: Path) -> list[list[str]]:
    """The command lines of `pcmrs` and `pcmrs-router` in a page, without what other programs are told."""
    found = []
    for piece in re.findall(r"```sh\n(.*?)```|`([^`\n]+)`", page.read_text(), re.DOTALL):
        for line in "".join(piece).splitlines():
            for command in re.split(r"&&|>", line.partition("#")[0]):
                found += re.findall(r"(?:^|\s)(pcmrs(?:-router)? [-a-z].*)", command.strip())
    return [shlex.split(command) for command in found]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_every_command_that_is_shown_exists(page: Path) -> None:
    for name, *words in shown(page):
        command: click.Command = router if name == "pcmrs-router" else main
        while isinstance(command, click.Group) and words:
            inner = command.get_command(click.Context(command), words.pop(0))
            assert inner is not None, (name, words)
            command = inner
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("-")} <= known, (name, words)


def test_commands_are_found_in_the_pages() -> None:
    names = {" ".join(command[:3]) for command in shown(DEPLOY / "README.md")}

    assert {"pcmrs pki init", "pcmrs pki issue", "pcmrs health", "pcmrs lease take"} <= names


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_every_file_that_is_linked_exists(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_page_is_where_the_readme_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/var/lib")  # what the unit sets: %S
    settings, said = Settings(), (DEPLOY / "README.md").read_text()

    assert settings.console.enabled
    assert f"-L {settings.console.port}:{HOST}:{settings.console.port} " in said
    assert f"cat {settings.cell.path() / TOKEN}\n" in said
