"""The detector of the scene beside a simulated cell, as a process, and the hand before its simulated camera."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from pcmrs.messages import SceneEvent
from pcmrs.messages.scene_event import WATCHING
from pcmrs.service.processes.child import end_child
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet

WATCHED = (
    "scene_events.sources.camera={silent_after=1.5}",
    "scene_events.rules=[{label='intrusion', least_confidence=0.6}]",
)
"""Settings of a cell whose workspace is watched. A busy machine may keep the detector from its images for some time."""
COMMAND = (sys.executable, "-m", "pcmrs_lab.experiment.scene_detector")
SEES_WITHIN = 90.0
"""Limit for the detector to start and to learn the background, s."""
END_TIME = 5.0
ASIDE = (0.3, 0.45, 0.3)
"""Place of a hand in the workspace, beside the arm, m in the robot's base."""


class SceneCamera:
    """The detector's process, and the events that it publishes.

    Args:
        process: The process.

    Attributes:
        process: The process.
        events: All received events, oldest first, each with the time of its arrival, s of the event loop's clock.
    """

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self.process = process
        self.events: list[tuple[float, SceneEvent]] = []

    def tell(self, line: str) -> None:
        """Move the hand, or harm the camera; see `pcmrs_lab.experiment.scene_detector`."""
        if self.process.stdin is not None:
            self.process.stdin.write(f"{line}\n".encode())

    def show_hand(self) -> None:
        """Hold a hand into the workspace."""
        self.tell("hand {} {} {}".format(*ASIDE))

    def take(self, _key: str, event: SceneEvent) -> None:
        """Take an event from the bus."""
        self.events.append((asyncio.get_running_loop().time(), event))

    def count(self, label: str) -> int:
        """Return the number of received events with a label."""
        return sum(event.label == label for _, event in self.events)

    async def until_seen(self, label: str, within: float = SEES_WITHIN) -> None:
        """Wait for the next event with a label.

        Args:
            label: Label of the event.
            within: Time limit, s.

        Raises:
            Unmet: There was none in time.
        """
        before = self.count(label)
        try:
            async with asyncio.timeout(within):
                while self.count(label) == before:  # noqa: ASYNC110 - a poll needs no second mechanism
                    await asyncio.sleep(0.02)
        except TimeoutError:
            seen = sorted({event.reason or event.label for _, event in self.events})
            raise Unmet(f"The detector has not published {label} within {within:g} s, only {seen}.") from None


@asynccontextmanager
async def scene_camera(cell: RunningCell, settings: Sequence[str] = ()) -> AsyncIterator[SceneCamera]:
    """Run the detector for the length of the context; it sees when the context begins.

    Args:
        cell: Cell that it watches, with the settings `WATCHED`.
        settings: Further settings of the detector, ``key=value`` each.

    Raises:
        Unmet: It did not see within `SEES_WITHIN`.
    """
    log = cell.folder / "camera.log"
    words = [word for setting in (*cell.settings, *settings) for word in ("--set", setting)]
    with log.open("ab") as errors:
        process = await asyncio.create_subprocess_exec(
            *COMMAND, *words, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.DEVNULL, stderr=errors
        )
    camera = SceneCamera(process)
    end = cell.bus.subscribe("scene/*", SceneEvent, camera.take)
    try:
        await camera.until_seen(WATCHING)
        yield camera
    finally:
        await end()
        if process.returncode is None:
            process.terminate()
        await end_child(process, END_TIME)
