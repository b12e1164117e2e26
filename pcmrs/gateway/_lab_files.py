"""The lab's YAML files of the procedure, kept up to date in a folder for modules and scripts that read them."""

from __future__ import annotations

import asyncio
import errno
import os
import stat
import threading
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import IO

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher import DispatcherListener
from pcmrs.files import SECRET, write_durably
from pcmrs.formats.lab_files import CLOUD, REGISTRATION, TOOL_POSE, LabProcedure, procedure_texts
from pcmrs.formats.lab_text import IN_FORCE, REVOKED
from pcmrs.formats.reading import MAX_TEXT_BYTES
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs.workflows.data import PlacementData, as_transform

OTHERS_READ = 0o044
"""Rights of others to read."""
NOT_WRITTEN = "lab_files_not_written"
"""Reason of the report that a file could not be written."""

STUCK = "lab_files_stuck"
"""Reason of the report that writing does not end."""
STUCK_AFTER = 5.0
"""Time after which writing counts as stuck, s."""

Parts = tuple[object, object, object, object, object]


class LabFileWriter(DispatcherListener):
    """Writer of each file, whole, in a thread, when what it holds has changed; the newest data wins.

    A folder on a share that hangs blocks the thread for any time. So it is a daemon thread: the loop's default threads
    would keep the process from ending.

    A file stays when its data is gone, as in the lab's software: registration and tool pose then say that they are
    revoked, and the points of the surface are emptied. A file that cannot be written is reported, and written with the
    next change.

    Args:
        core: The daemon, which has the data.
        clock: The machine's clock, for the time in the plan of the landmarks.
        folder: Folder of the files. It must exist.
        tasks: Owner of the task that writes.
        refusals: Log and journal of what cannot be written.
    """

    def __init__(self, core: Core, clock: Clock, folder: Path, tasks: BackgroundTasks, refusals: RejectionLog) -> None:
        self._core = core
        self._clock = clock
        self._folder = folder
        self._refusals = refusals
        self._tasks = tasks
        self._seen: Parts | None = None
        self._written: Parts | None = None
        self._planned_at = 0.0
        self._on_disk: dict[str, str] = {}
        self._writing = False

    def start(self) -> None:
        """Begin with the present data."""
        self._look()

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Notice changed data; never waits."""
        if isinstance(message, Snapshot):
            self._look()

    def _look(self) -> None:
        parts = _parts(self._core.data())
        if parts == self._seen:  # parts that have not changed are the same objects, so that this is fast
            return
        if self._seen is None or parts[0] != self._seen[0]:
            self._planned_at = self._clock.wall()
        self._seen = parts
        if not self._writing:
            self._writing = True
            self._tasks.spawn(self._write())

    async def _write(self) -> None:
        try:
            while self._written is not self._seen:
                self._written = self._seen
                data, when = self._core.data(), datetime.fromtimestamp(self._planned_at)
                error = await self._outcome(_in_thread(partial(self._write_changed, data, when)))
                if isinstance(error, OSError):
                    self._report_failure(error)
                elif error is not None:
                    raise error
        finally:
            self._writing = False

    async def _outcome(self, written: asyncio.Future[Exception | None]) -> Exception | None:
        """Wait for the end of a write, and report once that it does not come; return its error."""
        try:
            with suppress(TimeoutError):
                async with self._clock.timeout(STUCK_AFTER):
                    return await asyncio.shield(written)
        except asyncio.CancelledError:
            if not written.done():
                self._report_stuck("when the daemon ended")
            raise
        self._report_stuck(f"for {STUCK_AFTER:g} s")
        return await written

    def _report_stuck(self, when: str) -> None:
        text = (
            f"{self._folder} has not been written {when}: the lab's files may not be those of the procedure, and may "
            "say that what is revoked is in force. Check its disk or network share."
        )
        self._refusals.add("gateway", STUCK, text)

    def _report_failure(self, error: OSError) -> None:
        file = error.filename2 or error.filename or self._folder
        text = (
            f"{file} cannot be read or replaced ({error.strerror}): the lab's files are not those of the procedure. "
            "Make room or give rights; they are written with the next change."
        )
        self._refusals.add("gateway", NOT_WRITTEN, text)

    def _write_changed(self, data: PlacementData, when: datetime) -> None:
        """Write the files whose text has changed, revocations first; in a thread, one call at a time.

        Raises:
            OSError: The first file that cannot be read or written. All others are written.
        """
        texts, revoked = procedure_texts(_lab_procedure(data), when), {}
        failures: list[OSError] = []
        for name in (REGISTRATION, TOOL_POSE):
            if name in texts:
                texts[name] += IN_FORCE
                continue
            try:
                if (text := _revoked(self._folder / name)) is not None:
                    revoked[name] = text
            except OSError as error:
                failures.append(error)
        if CLOUD in self._on_disk:
            texts.setdefault(CLOUD, "")
        for name, text in (revoked | texts).items():
            if self._on_disk.get(name) != text:
                try:
                    self._replace(name, text)
                except OSError as error:
                    failures.append(error)
                else:
                    self._on_disk[name] = text
        if failures:
            raise failures[0]

    def _replace(self, name: str, text: str) -> None:
        """Replace a file as a whole. Those who may read the folder may read it, whatever the mask of the daemon is.

        Raises:
            OSError: It cannot be written.
        """
        mode = SECRET | self._folder.stat().st_mode & OTHERS_READ
        write_durably(self._folder / name, text.encode("utf-8"), mode=mode, masked=False)


def _in_thread(work: Callable[[], None]) -> asyncio.Future[Exception | None]:
    """Run a function in its own daemon thread; the future gets its error, or None."""
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[Exception | None] = loop.create_future()

    def settle(error: Exception | None) -> None:
        if not ended.done():
            ended.set_result(error)

    def run() -> None:
        error = None
        try:
            work()
        except Exception as raised:
            error = raised
        with suppress(RuntimeError):  # the loop has been closed meanwhile
            loop.call_soon_threadsafe(settle, error)

    threading.Thread(target=run, name="pcmrs-lab-files", daemon=True).start()
    return ended


def _revoked(path: Path) -> str | None:
    """Return the text of a file that says it is in force, with the opposite; None for another file, or none.

    Others may write into the folder. A link there may lead to a secret, and a pipe blocks its reader.

    Raises:
        OSError: It cannot be read, is no regular file, or is larger than any file of the lab.
    """
    try:
        with _opened(path) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise OSError(errno.EINVAL, "not a regular file", str(path))
            content = file.read(MAX_TEXT_BYTES + 1)
    except FileNotFoundError:
        return None
    if len(content) > MAX_TEXT_BYTES:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    text = content.decode("utf-8", errors="replace")
    return text.removesuffix(IN_FORCE) + REVOKED if text.endswith(IN_FORCE) else None


def _opened(path: Path) -> IO[bytes]:
    return open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK))


def _parts(data: PlacementData) -> Parts:
    """Return the data that the files hold."""
    return data.landmarks, data.digitized, data.registered, data.plan, data.surface


def _lab_procedure(data: PlacementData) -> LabProcedure:
    registered = data.registered
    return LabProcedure(
        tuple(landmark.position for landmark in data.landmarks),
        data.digitized,
        None if registered is None else as_transform(registered.body_ref_from_image),
        registered is not None and bool(registered.covariance),
        None if data.plan is None else as_transform(data.plan),
        data.surface,
    )
