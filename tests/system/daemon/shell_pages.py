"""A page's shell blocks, done as a user does them: in a real shell, with daemons that run beside it."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from tests.system.daemon.daemon_process import START_TIME, own_settings, wait_until

SERVE = "pcmrs-serve"
KEPT_RUNNING = (SERVE, "pcmrs watch", "pcmrs console")
"""Commands that a user leaves running in a terminal of their own, until Ctrl-C."""
PATIENT = ("cell.rate=2", "robot.deadman=1", *LIGHT)
"""No page shows what comes of a machine that has no time for the daemon, or what the arm weighs."""
SHELLS = ("sh", "bash", "console")
DONE = "the command has ended: "

_BLOCK = re.compile(r"^```(\w+) ?([\w.-]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Shown:
    """One command of a page and what it prints there; ``…`` stands for anything, None for what is not shown."""

    command: str
    output: str | None = None

    def matches(self, printed: str) -> bool:
        if self.output is None:
            return True
        pattern = ".*".join(re.escape(part) for part in self.output.strip().split("…"))
        return re.fullmatch(pattern, printed.strip(), re.DOTALL) is not None

    @property
    def program(self) -> str:
        """Which of the commands that are kept running it is; empty for all others."""
        words = f"{self.command} "
        return next((each for each in KEPT_RUNNING if words.startswith(f"{each} ")), "")


class ShownPage:
    """The blocks of a page.

    Args:
        path: Of the page.
        replaced: What the page says in place of what a test has, such as the ports that it may use.
    """

    def __init__(self, path: Path, replaced: Mapping[str, str] | None = None) -> None:
        text = path.read_text()
        for said, meant in (replaced or {}).items():
            text = text.replace(said, meant)
        self._blocks: list[tuple[str, str, str]] = _BLOCK.findall(text)

    def files(self) -> dict[str, str]:
        """The files that the page has the user write: pieces of one name are put one after the other."""
        named = sorted((block for block in self._blocks if block[1]), key=lambda block: block[1])
        return {
            name: "\n".join(block[2] for block in pieces) for name, pieces in groupby(named, key=lambda block: block[1])
        }

    def commands(self) -> Iterator[Shown]:
        """All commands in order: those behind a ``$`` with what they print, and every line of a block without any."""
        for kind, name, text in self._blocks:
            if kind not in SHELLS or name:
                continue
            if kind == "console":
                for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
                    command, _, output = part.partition("\n")
                    yield Shown(command, output)
            else:
                for line in filter(None, map(str.strip, text.splitlines())):
                    yield Shown(line)


class User:
    """Works in one folder and one shell, with a cell that nobody else has; use it as a context.

    Args:
        folder: Where the shell begins; the cell's journal and records are kept beside it.
        daemon_lasts: A daemon that is started again in the same words continues, so that pages can share it.

    Attributes:
        daemons_started: How many daemons said that they are ready.
        planner_port: Where they take datagrams.
        console_port: Where the console serves its page.
        packages: What is installed there is found.
        endpoint: Of the cell's bus.
        folder: Where the shell begins.
    """

    def __init__(self, folder: Path, *, daemon_lasts: bool = False) -> None:
        self.daemons_started = 0
        self.planner_port, self.console_port = free_port(), free_port()
        self.packages = folder.with_name("packages")
        self.folder = folder
        own = [each for each in own_settings(folder) if not each.startswith(("cell.site", "cell.name", "cell.folder"))]
        self.endpoint = next(each for each in own if each.startswith("cell.endpoint")).partition("=")[2]
        self._settings = [*own, f"gateway.planner.port={self.planner_port}", *PATIENT]
        self._environment = {
            **os.environ,
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PCMRS_ENDPOINT": self.endpoint,
            "PYTHONPATH": os.pathsep.join(filter(None, (str(self.packages), os.environ.get("PYTHONPATH")))),
            "XDG_STATE_HOME": str(folder.with_name("state")),
        }
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._daemon_lasts, self._daemon_words = daemon_lasts, list[str]()
        self._shell = self._started(["bash"], "shell", stdin=subprocess.PIPE)

    def __enter__(self) -> User:
        return self

    def __exit__(self, *_error: object) -> None:
        for program in list(self._running):
            self.interrupts(program)
        os.killpg(self._shell.pid, signal.SIGKILL)  # with what it runs in the background
        self._shell.wait()
        if self._shell.stdin is not None:
            self._shell.stdin.close()

    def types(self, shown: Shown) -> tuple[str, int]:
        """What a command prints, and its exit status: 0 for one that is kept running, once it has printed that."""
        return self._keeps_running(shown) if shown.program else self._runs(shown.command)

    def interrupts(self, program: str) -> None:
        """Ctrl-C."""
        process = self._running.pop(program)
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        try:
            process.wait(START_TIME)
        finally:
            process.kill()

    def ended(self) -> list[str]:
        """Commands that still run after Ctrl-C; a daemon that lasts is not among them."""
        programs = [each for each in self._running if not (self._daemon_lasts and each == SERVE)]
        for program in programs:
            self.interrupts(program)
        return programs

    def complaints(self, program: str) -> str:
        """What was said on standard error by the shell's commands, or by one that was kept running."""
        return self._file(f"{program}.errors").read_text(errors="replace")

    def printed(self, program: str) -> str:
        """Everything that a command that is kept running has printed."""
        return self._file(program).read_text(errors="replace")

    def _runs(self, command: str) -> tuple[str, int]:
        before = len(self.printed("shell"))
        assert self._shell.stdin is not None
        self._shell.stdin.write(f"{{ {command}\n}} </dev/null; echo {shlex.quote(DONE)}$?\n".encode())
        self._shell.stdin.flush()
        end = re.compile(rf"{DONE}(\d+)\n$")
        ended = wait_until(lambda: end.search(self.printed("shell")[before:]) is not None, START_TIME)
        printed = self.printed("shell")[before:]
        assert ended, f"$ {command}\n{printed}\n{self.complaints('shell')}"
        return end.sub("", printed), int(printed.rpartition(" ")[2])

    def _keeps_running(self, shown: Shown) -> tuple[str, int]:
        program = shown.program
        if not shown.output:  # a daemon is ready before anything else is typed; what others say comes later
            shown = Shown(shown.command, "…ready" if program == SERVE else None)
        words = shlex.split(shown.command, comments=True)
        if program == SERVE and self._daemon_lasts and program in self._running and words == self._daemon_words:
            return self.printed(program), 0
        if program in self._running:
            self.interrupts(program)
        if program == SERVE:
            self._daemon_words = words.copy()
            words[1:1] = [word for setting in self._settings for word in ("--set", setting)]
        process = self._running[program] = self._started(words, program)
        wait_until(lambda: shown.matches(self.printed(program)) or process.poll() is not None, START_TIME)
        status = process.poll()
        self.daemons_started += program == SERVE and status is None
        return self.printed(program) if not status else self.complaints(program), status or 0

    def _started(self, words: list[str], name: str, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
        with self._file(name).open("wb") as output, self._file(f"{name}.errors").open("wb") as errors:
            return subprocess.Popen(
                words,
                cwd=self.folder,
                env=self._environment,
                stdin=stdin,
                stdout=output,
                stderr=errors,
                start_new_session=True,
            )

    def _file(self, name: str) -> Path:
        return self.folder.with_name(name)


def written_home(folder: Path, page: ShownPage) -> Path:
    """A new folder with the files that the page has the user write."""
    home = folder / "home"
    home.mkdir()
    for name, text in page.files().items():
        (home / name).write_text(text)
    return home
