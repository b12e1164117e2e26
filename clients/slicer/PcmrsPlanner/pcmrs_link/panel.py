"""What a panel shows of a cell: states, poses and running jobs, each with its age."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from .feed import Feed
from .link import Link
from .planner import Planner
from .poses import Pose

FRESH = 0.5
"""A pose older than this is shown as not seen now, s."""

UPRIGHT = (0.0, 0.0, 0.0, 1.0)

LIVE = {
    "PcmrsTool": ("tool", "CoilToImage"),
    "PcmrsPointer": ("tip", "PointerTipToImage"),
    "PcmrsBody": (None, "ReferenceToImage"),
    "PcmrsTarget": (None, "TargetToImage"),
}
"""Transforms of the scene: which stream of the string protocol and which transform of OpenIGTLink tell them."""

Row = tuple[str, str, str]


@dataclass(frozen=True)
class Shown:
    """A pose in the image, mm RAS, and when it was received, by the link's clock."""

    pose: Pose
    at: float


def poses(link: Link, feed: Feed | None) -> dict[str, Shown]:
    """Newest received pose of each of `LIVE`."""
    found = {}
    for name, (stream, transform) in LIVE.items():
        told = [link.seen.get(stream or ""), feed.seen.get(transform) if feed is not None else None]
        newest = max((each for each in told if each is not None), key=lambda seen: seen.at, default=None)
        if newest is not None:
            found[name] = Shown(_pose(newest.value), newest.at)
    return found


def pose_rows(link: Link, feed: Feed | None) -> list[Row]:
    """Name, position and age of each pose; one that is not fresh says so, wherever the scene still shows it."""
    rows = []
    for name, shown in poses(link, feed).items():
        age = link.clock() - shown.at
        place = " ".join(f"{value:.1f}" for value in shown.pose.position)
        rows.append((name, place, "now" if age <= FRESH else f"NOT SEEN for {age:.0f} s"))
    return rows


def branch_rows(planner: Planner, feed: Feed | None) -> list[Row]:
    """Name, state and age of each branch: as OpenIGTLink tells it, or else as the last verdict about it did."""
    if feed is not None and feed.state is not None:
        return [(branch, state, "now") for branch, state in feed.state.branches.items()]
    now = planner.link.clock()
    return [(branch, known.state, f"{now - known.at:.0f} s ago") for branch, known in planner.known.items()]


def status(planner: Planner, feed: Feed | None) -> str:
    """One line: the most urgent thing to know."""
    link, state = planner.link, feed.state if feed is not None else None
    if link.stopping:
        return "STOP IS NOT ANSWERED YET: use the emergency stop"
    if state is not None and state.latched:
        return "Stopped and latched: an operator has to acknowledge it"
    if state is not None and state.prompt:
        return state.prompt
    if link.under_way is not None:
        return f"{link.under_way}: {link.waited:.0f} s"
    if state is not None and state.running:
        return "Running: " + ", ".join(state.running)
    return "Ready" if planner.last is None else f"{planner.last[0]}: {planner.last[1]}"


def _pose(value: Pose | Sequence[float]) -> Pose:
    """A pose as it is; a point as one that is not turned."""
    return value if isinstance(value, Pose) else Pose(tuple(value), UPRIGHT)


def results(planner: Planner) -> list[str]:
    """Last measurements, as lines: residual of the registration, and errors of the placement."""
    lines = []
    if planner.residual is not None:
        lines.append(f"Residual {planner.residual:.2f} mm")
    if planner.placement is not None:
        placed = planner.placement
        lines.append(f"Placed within {placed.translation_error:.2f} mm, {placed.rotation_error:.2f} degrees")
    return lines
