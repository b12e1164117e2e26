"""``docs/new-workflow.md`` done literally, as a new user does it: its files written, its commands run in order."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import pytest
from daemon_process import START_TIME, ServeProcess, as_words, own_settings, run_pcmrs, running_daemon

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "new-workflow.md").read_text()
BLOCKS: list[tuple[str, str, str]] = re.findall(r"^```(\w+) ?([\w.-]*)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Shown:
    """One command of the page and what it prints there; ``…`` stands for anything."""

    command: str
    output: str

    def matches(self, printed: str) -> bool:
        pattern = ".*".join(re.escape(part) for part in self.output.strip().split("…"))
        return re.fullmatch(pattern, printed.strip(), re.DOTALL) is not None


def _files() -> dict[str, str]:
    """The files that the page has the user write: pieces of one name are put one after the other."""
    named = sorted((block for block in BLOCKS if block[1]), key=lambda block: block[1])
    return {
        name: "\n".join(block[2] for block in pieces) for name, pieces in groupby(named, key=lambda block: block[1])
    }


def _sessions() -> Iterator[Shown]:
    for kind, _, text in BLOCKS:
        if kind == "console":
            for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                command, _, output = part.partition("\n")
                yield Shown(command, output)


def test_the_page_and_the_example_are_the_same_files() -> None:
    folder = ROOT / "examples" / "biopsy"
    written = _files()
    for name in ("biopsy.toml", "biopsy.py", "landmarks.json"):
        assert written[name] == (folder / name).read_text()


@pytest.mark.nightly
def test_a_new_user_gets_what_the_page_shows(tmp_path: Path) -> None:
    home, cell = tmp_path / "home", tmp_path / "cell"
    home.mkdir()
    cell.mkdir()
    for name, text in _files().items():
        (home / name).write_text(text)
    user = User(home, cell)
    with ExitStack() as daemons:
        for shown in _sessions():
            printed = user.types(shown, daemons)
            assert shown.matches(printed), f"$ {shown.command}\n{printed}"
        assert user.daemons_started == 2


class User:
    """Works in one folder, with a cell that nobody else has."""

    def __init__(self, home: Path, cell: Path) -> None:
        self._home = home
        self._cell = cell
        self._settings = own_settings(cell)
        self._address: dict[str, str] = {}
        self.daemons_started = 0

    def types(self, shown: Shown, daemons: ExitStack) -> str:
        """Runs a command of the page and returns what it prints."""
        if shown.command.startswith("pcmrs-serve "):
            return self._serve(shown, daemons)
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = {**os.environ, **self._address, "PATH": path}
        ended = subprocess.run(
            ["bash", "-c", shown.command],
            cwd=self._home,
            env=environment,
            capture_output=True,
            text=True,
            timeout=START_TIME,
            check=False,
        )
        assert "Traceback" not in ended.stderr, ended.stderr
        return ended.stdout

    def _serve(self, shown: Shown, daemons: ExitStack) -> str:
        """A daemon that runs until the next one; or the text of one that is refused."""
        words = shlex.split(shown.command)[1:]
        given = [word for word in words if word != "--set"]
        settings = [*self._settings, *(word.replace("=biopsy", f"={self._home}/biopsy") for word in given)]
        daemons.close()
        if not shown.output.rstrip().endswith("ready"):
            return run_pcmrs("serve", *as_words(settings)).stderr.partition(": ")[2]
        daemon: ServeProcess = daemons.enter_context(running_daemon(settings, self._cell))
        self._address = {"PCMRS_ENDPOINT": daemon.ready.endpoint, "PCMRS_SITE": "test", "PCMRS_CELL": daemon.cell}
        self.daemons_started += 1
        return f"pcmrs-serve: {daemon.ready.workflow}. Research software, not a medical device.\n\nready"
