"""A daemon with a wall clock that is set while it runs; its monotonic clock is the machine's.

libfaketime 0.9.10, which Debian 12 has, is of no use for that: under it Zenoh's threads spin, and `time.sleep` of
Python 3.11 fails where the monotonic clock is left alone.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.clock import SystemClock
from pcmrs_lab.campaign.needs import Need

SOURCE: Final = Path(__file__).with_suffix(".c")
COMPILER: Final = "cc"
_SETTING: Final = struct.Struct("=qq")
_NANO: Final = 1_000_000_000


@dataclass(frozen=True, slots=True)
class WallClock:
    """Sets the wall clock of the processes that were started with its environment.

    Attributes:
        folder: Of its own; holds what the processes load, and the setting that they look at.
    """

    folder: Path

    @classmethod
    def right(cls, folder: Path) -> WallClock:
        """One that is right as yet."""
        clock = cls(folder)
        folder.mkdir(parents=True, exist_ok=True)
        clock._setting.write_bytes(_SETTING.pack(0, 0))
        command = [COMPILER, "-shared", "-fPIC", "-O2", "-o", str(clock._library), str(SOURCE), "-ldl"]
        subprocess.run(command, check=True, capture_output=True)
        return clock

    def shift(self, seconds: float) -> None:
        """The wall clock is so much ahead of the machine's from now on; behind when negative."""
        self._set(int(seconds * _NANO), 0)

    def stand(self) -> None:
        """The wall clock stands from now on."""
        self._set(0, int(SystemClock().wall() * _NANO))

    def environment(self) -> dict[str, str]:
        """Variables for a process whose wall clock this is."""
        return {"LD_PRELOAD": str(self._library), "PCMRS_WALL_CLOCK": str(self._setting)}

    def _set(self, ahead: int, stands: int) -> None:
        with self._setting.open("r+b") as file:  # in place: the processes have mapped it
            file.write(_SETTING.pack(ahead, stands))

    @property
    def _setting(self) -> Path:
        return self.folder / "wall_clock"

    @property
    def _library(self) -> Path:
        return self.folder / "wall_clock.so"


NEEDS = (Need("a C compiler", lambda: shutil.which(COMPILER) is not None),)
