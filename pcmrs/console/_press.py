"""Press of a button as the browser reports it: with the meaning at the press, and how old the report is. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

BEAT_PERIOD: Final = 0.5
"""Period at which the page gets the server's time, s."""
LATE: Final = 2.0
"""Age from which a press is too old to act, s: one period of the beat, and the delays of a busy browser both ways."""


def beat_of(now: float) -> str:
    """Return the beat that the page gets at a time.

    Args:
        now: Present time of the server, s of its steady clock.
    """
    return f"{now:.3f}"


@dataclass(frozen=True, slots=True)
class Press:
    """One press.

    Attributes:
        meaning: Meaning of the button as it was pressed; empty if it is not known.
        beat: Newest beat of the server that the page had when it reported the press; NaN if it had none.
    """

    meaning: str
    beat: float

    @staticmethod
    def of(reported: Any) -> Press:
        """Return the press that a page reports.

        Args:
            reported: Decoded JSON from the browser, of which nothing is known.
        """
        fields: Mapping[str, Any] = reported if isinstance(reported, Mapping) else {}
        try:
            beat = float(str(fields.get("beat")))
        except ValueError:
            beat = math.nan
        return Press(str(fields.get("meaning", "")), beat)

    def is_late(self, now: float) -> bool:
        """Return true if the report took too long to arrive, or its age is not known.

        Args:
            now: Present time of the server, s of its steady clock.
        """
        return not -0.001 <= now - self.beat <= LATE
