"""The recorder of the daemon's session, as a child process: what it does or does not, control goes on."""

from __future__ import annotations

import asyncio
import datetime
from collections.abc import Callable

import structlog

from pcmrs.clock import Clock
from pcmrs.messages import DeviceEvent
from pcmrs.recording.settings import FOLDER
from pcmrs.service.children import end_child, open_child
from pcmrs.service.supervisor import RESTARTS, WITHIN, RestartLimit, Supervisor
from pcmrs.settings import Settings

log = structlog.get_logger(__name__)

ENDING_TIME = 5.0
"""A recorder that has not written its last file so long after it was told to end is killed, s."""

_SAID_WHY = 2
"""From this exit status on the recorder has ended for a reason that a new one would end for, too."""


class RecorderProcess:
    """Records the session into the cell's folder; begun anew when it is killed, never a reason to stop anything.

    Args:
        settings: Of the daemon, handed to the recorder on its standard input.
        session: Id of the session, as the journal has it.
        report: Told when the recorder has ended by itself.
        clock: The machine's.

    Attributes:
        ended: Why the recorder ended and is not begun anew; empty while it records, or is not to.
    """

    def __init__(self, settings: Settings, session: str, report: Callable[[DeviceEvent], None], clock: Clock) -> None:
        self._settings = settings
        self._session = session
        self._report = report
        self._clock = clock
        self.ended = ""
        self._process: asyncio.subprocess.Process | None = None

    def start(self, supervisor: Supervisor) -> None:
        """Starts the recorder, if the session is to be recorded."""
        if self._settings.recording.enabled:
            supervisor.start("recorder", self._keep)

    async def stop(self) -> None:
        """Lets the recorder write what it has heard, and waits for its end."""
        process = self._process
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        if not await end_child(process, ENDING_TIME):
            log.warning("recorder_killed")

    async def _keep(self) -> None:
        limit = RestartLimit(RESTARTS, WITHIN, self._clock)
        given_up = False
        while not given_up:
            try:
                process = self._process = await self._open()
            except OSError as error:  # of the folder or the child: no reason to end with the supervisor
                given_up, why = True, error.strerror or str(error)
            else:
                status = await process.wait()
                given_up, why = status >= _SAID_WHY or limit.reached(), f"status {status}"
            log.error("recorder_ended", why=why, given_up=given_up)
            self._report(_ended(why, given_up=given_up))
        self.ended = why
        await asyncio.Event().wait()

    async def _open(self) -> asyncio.subprocess.Process:
        folder = self._settings.cell.path() / FOLDER
        folder.mkdir(exist_ok=True)
        begun = datetime.datetime.fromtimestamp(self._clock.wall(), datetime.UTC)
        name = f"{begun:%Y%m%dT%H%M%SZ}-{self._session[:8]}.mcap"
        words = ("record", str(folder / name), "--lifeline", "--session", self._session)
        return await open_child(*words, settings=self._settings, stdout=asyncio.subprocess.DEVNULL)


def _ended(why: str, *, given_up: bool) -> DeviceEvent:
    code, then = ("recording_ended", "is not begun anew") if given_up else ("recorder_restarted", "is begun anew")
    text = f"The recorder ended by itself ({why}) and {then}; the cell works on. The log says more."
    return DeviceEvent(device="daemon", code=code, text=text, fields={"why": why})
