"""A daemon with a wall clock that is set while it runs, by libfaketime; its monotonic clock is the machine's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pcmrs.campaign.needs import Need

LIBRARY = "faketime/libfaketimeMT.so.1"
CACHED = 1
"""Seconds for which a process goes on by what it has read last: reading at every look takes most of its time."""

LIBRARIES = (Path("/usr/lib"), Path("/usr/local/lib"))


@dataclass(frozen=True, slots=True)
class WallClock:
    """Sets the wall clock of the processes that were started with its environment.

    Attributes:
        file: That libfaketime reads once in `CACHED` s.
    """

    file: Path

    @classmethod
    def right(cls, folder: Path) -> WallClock:
        """One that is right as yet."""
        clock = cls(folder / "faketime")
        clock.shift(0.0)
        return clock

    def shift(self, seconds: float) -> None:
        """The wall clock is so much ahead of the machine's from now on; behind when negative."""
        self.file.write_text(f"{seconds:+.0f}\n")

    def stand(self) -> None:
        """The wall clock stands from now on."""
        self.file.write_text("2026-01-01 12:00:00\n")

    def environment(self) -> dict[str, str]:
        """Variables for a process whose wall clock this is."""
        return {
            "LD_PRELOAD": str(_libraries()[0]),
            "FAKETIME_TIMESTAMP_FILE": str(self.file),
            "FAKETIME_CACHE_DURATION": str(CACHED),
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }


def _libraries() -> list[Path]:
    """Where libfaketime is."""
    return [path for place in LIBRARIES for folder in ("", "*/") for path in sorted(place.glob(folder + LIBRARY))]


NEEDS = (Need("libfaketime", lambda: bool(_libraries())),)
