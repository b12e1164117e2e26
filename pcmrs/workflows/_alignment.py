"""Alignment: the tracker's continuous check that the tool is near enough to its planned pose to treat."""

from __future__ import annotations

import asyncio
import math
from typing import Any

from pcmrs.devices.poses import Sighting
from pcmrs.dispatcher import Activity as AnyActivity
from pcmrs.dispatcher import Registry
from pcmrs.dispatcher import Run as AnyRun
from pcmrs.errors import RefusalError
from pcmrs.messages import Verdict
from pcmrs.spatial import Transform
from pcmrs.workflows._correction import size_mm_deg
from pcmrs.workflows._placement import target_pose
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform
from pcmrs.workflows.settings import AlignmentSettings

Activity = AnyActivity[Cell, PlacementData]
Run = AnyRun[Cell, PlacementData]
TrackerFrame = dict[str, Sighting]
"""One frame of the tracker that shows tool and body, by the name of the marker body."""

BODIES = ("coil", "body_ref")
WATCHING = {"placed": "watch_alignment", "following": "follow_head"}
"""Activity that watches alignment in each state of the placement."""
CHECKS_PER_LOSS = 5
"""Number of checks within the time after which alignment is lost. By default a check takes less time than a frame of
the tracker."""
MIN_PAUSE = 0.02
"""Shortest time between two checks, s."""
PUBLISH_INTERVAL = 0.5
"""Time between two snapshots with the error, s."""
REPEAT_INTERVAL = 0.25
"""Time after which a refused event is posted again, s. An event that still waits is not repeated."""


class AlignmentGate:
    """Gate with hysteresis: it opens after the error was small for a while, and closes after it was large for a while.

    Args:
        settings: Thresholds and times.

    Attributes:
        open: True while the tool is aligned; False at the start.
    """

    def __init__(self, settings: AlignmentSettings) -> None:
        self._settings = settings
        self._within_since: float | None = None
        self._beyond_since: float | None = None
        self.open = False

    def update(self, time: float, error: tuple[float, float] | None) -> bool:
        """Take the error at a time, and return the state of the gate.

        Args:
            time: Time of the error, s.
            error: Translation in mm and rotation in deg; None if the tool or the body is not seen.
        """
        limits = self._settings
        within = error is not None and error[0] <= limits.on_mm and error[1] <= limits.on_deg
        beyond = error is None or error[0] > limits.off_mm or error[1] > limits.off_deg
        self._within_since = _since(self._within_since, time) if within else None
        self._beyond_since = _since(self._beyond_since, time) if beyond else None
        if self._within_since is not None and time - self._within_since >= limits.on_time:
            self.open = True
        if self._beyond_since is not None and time - self._beyond_since >= limits.off_time:
            self.open = False
        return self.open


def _since(started_at: float | None, time: float) -> float:
    return time if started_at is None else started_at


class AlignmentWatch:
    """Watch of the tracker's frames, which posts ``within`` and ``outside`` and shows the error in the snapshot.

    The error is that of the newest frame, tool against body at one time of exposure. It is as old as the tracker's
    latency, and its noise counts as error.

    Args:
        act: Activity that runs the watch.
    """

    def __init__(self, act: Activity) -> None:
        self._act = act
        self._gate = AlignmentGate(act.cell.settings.alignment)
        self._error: tuple[float, float] | None = None
        self._requested: bool | None = None
        self._request: asyncio.Future[Verdict] | None = None
        self._seen_at = self._requested_at = self._published_at = -math.inf

    def take(self, frame: TrackerFrame, measured_from_desired: Transform) -> None:
        """Take the error of a frame.

        Args:
            frame: Frame of the tracker.
            measured_from_desired: Desired pose of the tool in its measured frame.
        """
        self._error, self._seen_at = size_mm_deg(measured_from_desired), frame["coil"].captured

    def evaluate(self, **values: Any) -> None:
        """Evaluate the gate now, and post an event if alignment has changed.

        Args:
            **values: Values to show in the snapshot in addition to the error.
        """
        act, now = self._act, self._act.clock.monotonic()
        if now - self._seen_at > act.cell.settings.following.longest_gap:
            self._error = None
        aligned = self._gate.update(now, self._error)
        changed = aligned != self._requested  # only repeats wait, so that the gate can close at once after it opened
        if aligned != (act.states["alignment"] == "1") and (changed or self._may_repeat(now)):
            self._requested_at, self._requested = now, aligned
            self._request = act.post("alignment", "within" if aligned else "outside")
        if now - self._published_at >= PUBLISH_INTERVAL:
            self._published_at = now
            error_mm, error_deg = self._error or (None, None)
            act.show(error_mm=_rounded(error_mm), error_deg=_rounded(error_deg), **values)

    def _may_repeat(self, now: float) -> bool:
        """Return True if the last event may be posted again.

        While a motion holds the branch, the event waits for it, and repeats would only be refused afterwards.
        """
        return now - self._requested_at >= REPEAT_INTERVAL and (self._request is None or self._request.done())


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)


def desired_in_body_ref(cell: Cell, data: PlacementData) -> Transform | None:
    """Return ``body_ref_from_tool_tip`` as planned and nudged; None if there is no registration or plan.

    Args:
        cell: Cell with the settings.
        data: Data of the procedure.
    """
    if data.registered is None or data.plan is None:
        return None
    return as_transform(data.registered.body_ref_from_image) @ target_pose(data, cell.settings.placement.confirm_offset)


def measured_from_desired(cell: Cell, frame: TrackerFrame, body_ref_from_tool_tip: Transform) -> Transform:
    """Return the error of the tool's pose in a frame, along its own axes.

    Args:
        cell: Cell with the calibration of the tool.
        frame: Frame of the tracker.
        body_ref_from_tool_tip: Desired pose of the tool.
    """
    tracker_from_desired = frame["body_ref"].tracker_from_body @ body_ref_from_tool_tip
    return cell.mounting.tool_tip(frame["coil"].tracker_from_body).inverse() @ tracker_from_desired


async def watch_alignment(act: Activity) -> None:
    """Watch a tool that rests at the body until the activity is cancelled. A hidden tool or body is not aligned."""
    watch, number = AlignmentWatch(act), 0
    while True:
        for frame in act.cell.poses.frames_after(number, BODIES)[-1:]:
            number = frame["coil"].frame_number
            desired = desired_in_body_ref(act.cell, act.data)
            if desired is not None:
                watch.take(frame, measured_from_desired(act.cell, frame, desired))
        watch.evaluate()
        await act.clock.sleep(max(MIN_PAUSE, act.cell.settings.alignment.off_time / CHECKS_PER_LOSS))


def seen_by_present_watch(run: Run) -> None:
    """Refuse an event that has waited until another activity watches, because it reports an outdated observation."""
    if run.command.source != f"activity:{WATCHING[run.states['placement']]}":
        text = f"{run.command.source} no longer watches the tool: it is {run.states['placement']}."
        raise RefusalError("not_watching", text, source=run.command.source)


def register_alignment(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for this activity and check."""
    registry.check(seen_by_present_watch)
    registry.activity(watch_alignment)
