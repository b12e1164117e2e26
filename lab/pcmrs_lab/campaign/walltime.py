"""Daemon with a wall clock that is set while it runs; its monotonic clock is the machine's.

libfaketime 0.9.10 of Debian 12 does not work here: Zenoh's threads spin under it, and `time.sleep` of Python 3.11 fails
if the monotonic clock is left alone.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.clock import SystemClock
from pcmrs.testing.needs import Need

SOURCE: Final = Path(__file__).with_suffix(".c")
COMPILER: Final = "cc"
_SETTING: Final = struct.Struct("=qq")
_NANO: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class WallClock:
    """Wall clock of the processes that were started with its environment.

    Attributes:
        folder: Folder for the library that the processes load, and the setting that they read.
    """

    folder: Path

    @classmethod
    def create(cls, folder: Path) -> WallClock:
        """Compile the library, and return a clock that is not shifted yet."""
        clock = cls(folder)
        folder.mkdir(parents=True, exist_ok=True)
        clock._setting.write_bytes(_SETTING.pack(0, 0))
        command = [COMPILER, "-shared", "-fPIC", "-O2", "-o", str(clock._library), str(SOURCE), "-ldl"]
        subprocess.run(command, check=True, capture_output=True)
        return clock

    def shift(self, seconds: float) -> None:
        """Shift the wall clock against the machine's from now on.

        Args:
            seconds: Shift, s; negative to set it back.
        """
        self._set(int(seconds * _NANO), 0)

    def freeze(self) -> None:
        """Freeze the wall clock from now on."""
        self._set(0, int(SystemClock().wall() * _NANO))

    def environment(self) -> dict[str, str]:
        """Return the environment variables of a process with this wall clock."""
        return {"LD_PRELOAD": str(self._library), "PCMRS_WALL_CLOCK": str(self._setting)}

    def _set(self, ahead: int, stands: int) -> None:
        with self._setting.open("r+b") as file:  # in place, since the processes have mapped the file
            file.write(_SETTING.pack(ahead, stands))

    @property
    def _setting(self) -> Path:
        return self.folder / "wall_clock"

    @property
    def _library(self) -> Path:
        return self.folder / "wall_clock.so"


NEEDS = (Need("a C compiler", lambda: shutil.which(COMPILER) is not None),)
