"""How the guiding of a tool goes, for people."""

from __future__ import annotations

import math

from rich.text import Text

from pcmrs.messages import TeleopStatus, Verdict
from pcmrs.teleop.keyboard import HELP
from pcmrs.teleop.session import Told

LIMITS = {
    "height": "at the planned contact",
    "range": "as far as allowed",
    "turn": "turned as far as allowed",
    "zone": "too near to a zone",
    "reach": "at the end of a joint",
}


def line_of(status: TeleopStatus | None, *, keys: bool) -> Text:
    """The newest status, with the keys where they are what is moved."""
    text = Text(", ".join(_parts(status)) if status is not None else "waiting for the cell")
    return text.append(f"\n{HELP}", style="dim") if keys else text


def told_line(told: Told) -> str:
    """A refusal, or a danger."""
    if isinstance(told, Verdict):
        why = told.reason.text if told.reason is not None else "no reason"
        return f"{told.branch}.{told.operation} was {told.decision}: {why}"
    return f"{told.code}: {told.text}"


def _parts(status: TeleopStatus) -> list[str]:
    parts = ["clutch open" if status.user is None else f"engaged by {status.user}"]
    if status.round_trip is not None and status.jitter is not None:
        parts.append(f"{status.round_trip * 1000:.0f} ms ± {status.jitter * 1000:.0f}")
        parts.append("held: too late, let go once" if status.held else f"speed {status.scale * 100:.0f} %")
    if status.distance is not None and status.height is not None and status.turn is not None:
        distance_mm, height_mm = status.distance * 1000, status.height * 1000
        parts.append(
            f"{distance_mm:.1f} mm and {math.degrees(status.turn):.1f}° from the plan, {height_mm:.1f} mm above"
        )
    if status.limit is not None:
        parts.append(LIMITS[status.limit])
    if status.refused:
        parts.append(f"{sum(status.refused.values())} refused")
    return parts
