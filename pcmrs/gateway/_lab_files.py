"""The lab's YAML files of the procedure, kept up to date in a folder for modules and scripts that read them."""

from __future__ import annotations

import asyncio
from datetime import datetime
from pathlib import Path

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.dispatcher import DispatcherListener
from pcmrs.files import SECRET, write_durably
from pcmrs.formats.lab_files import CLOUD, REGISTRATION, TOOL_POSE, LabProcedure, procedure_texts
from pcmrs.formats.lab_text import IN_FORCE, REVOKED
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.messages import DeviceEvent, Snapshot, Verdict
from pcmrs.workflows.data import PlacementData, as_transform

OTHERS_READ = 0o044
"""Rights of others to read."""
NOT_WRITTEN = "lab_files_not_written"
"""Reason of the report that a file could not be written."""

Parts = tuple[object, object, object, object, object]


class LabFileWriter(DispatcherListener):
    """Writer of each file, whole, in a thread, when what it holds has changed; the newest data wins.

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
                try:
                    await asyncio.to_thread(self._write_changed, data, when)
                except OSError as error:
                    file = error.filename2 or error.filename or self._folder
                    text = (
                        f"{file} cannot be written ({error.strerror}): the lab's files are not those of the procedure. "
                        "Make room or give rights; they are written with the next change."
                    )
                    self._refusals.add("gateway", NOT_WRITTEN, text)
        finally:
            self._writing = False

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
        whole = self._folder / f".{name}"
        write_durably(whole, text.encode("utf-8"), mode=SECRET)
        whole.chmod(SECRET | self._folder.stat().st_mode & OTHERS_READ)
        whole.replace(self._folder / name)


def _revoked(path: Path) -> str | None:
    """Return the text of a file that says it is in force, with the opposite; None for another file, or none.

    Raises:
        OSError: It cannot be read.
    """
    text = path.read_text("utf-8", errors="replace") if path.exists() else ""
    return text.removesuffix(IN_FORCE) + REVOKED if text.endswith(IN_FORCE) else None


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
