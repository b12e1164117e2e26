"""A virtual cell in a process of its own, as a user runs it, for a daemon with the drivers of real devices."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcmrs.testing.daemon import free_port
from tests.system.daemon.daemon_process import PATIENCE, first_line


class VirtualCell:
    """Ports for a cabinet and a tracker, and the process that serves them while it runs.

    Args:
        folder: For its log.
    """

    def __init__(self, folder: Path) -> None:
        self._log = folder / "cell-log"
        self._kst, self._ndi = free_port(), free_port()
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def settings(self) -> list[str]:
        """Of a daemon that knows of the cell no more than a lab's daemon knows of its own."""
        others = [f"{device}.driver=none" for device in ("scene", "stimulator", "emg")]
        return [
            "cell.rate=1",
            "robot.driver=kst",
            f"kst.port={self._kst}",
            "kst.connect_timeout=1",
            "tracker.driver=ndi",
            f"ndi.device=127.0.0.1:{self._ndi}",
            "pointer.driver=dwell",
            "pointer.dwell.time=0.2",
            *others,
        ]

    @property
    def log(self) -> str:
        """Everything that it has written to standard error."""
        return self._log.read_text(errors="replace")

    @contextmanager
    def running(self, *settings: str) -> Iterator[None]:
        """Serves cabinet and tracker; ends with the context, if it has not been killed before."""
        ports = ["--kst-port", str(self._kst), "--ndi-port", str(self._ndi), "--accept-timeout", "600"]
        words = [word for setting in settings for word in ("--set", setting)]
        command = [sys.executable, "-c", "from pcmrs_sim.cli import main; main()", "cell", "--json", *ports, *words]
        with self._log.open("ab") as log:
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log)
        self._process = process
        try:
            assert process.stdout is not None
            served = json.loads(first_line(process.stdout) or "{}")
            assert served == {"kst": ["127.0.0.1", self._kst], "ndi": ["127.0.0.1", self._ndi]}, self.log
            yield
        finally:
            self.kill()

    def tell(self, line: str) -> None:
        """A fault, or what the person with the pointer is to do."""
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(line.encode() + b"\n")
        self._process.stdin.flush()

    def kill(self) -> None:
        """The cell is gone at once."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait(PATIENCE)
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
