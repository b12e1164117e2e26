"""Saved placements (YAML) and pose logs (CSV), in the formats that the laboratory's scripts read.

Lengths in m, quaternions x y z w, whatever the units of the links.
"""

from __future__ import annotations

import asyncio
import os
from datetime import datetime
from pathlib import Path

from pcmrs.background import BackgroundTasks
from pcmrs.clock import Clock
from pcmrs.errors import RefusalError
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.tracked_poses import TrackedPoses
from pcmrs.spatial import Transform

LOG_SECONDS = 5.0
LOG_RATE_HZ = 20.0


class PoseFileWriter:
    """Writer of records into one folder, each whole or not at all.

    Args:
        core: The daemon, which has the poses.
        clock: The machine's clock, for the rate of the log and the names of files.
        folder: Folder of the files. It is created with the first file.
        tasks: Owner of a running log.
    """

    def __init__(self, core: Core, clock: Clock, folder: Path, tasks: BackgroundTasks) -> None:
        self._core = core
        self._clock = clock
        self._folder = folder
        self._tasks = tasks
        self._log: asyncio.Task[Path] | None = None

    async def save_placement(self) -> Path:
        """Write the planned and the measured pose of the coil in the image; return the file.

        Raises:
            RefusalError: One of the two poses is not known.
        """
        planned, measured = self._core.target_in_image(), self._core.tool_in_image()
        if planned is None or measured is None:
            missing = "accepted plan" if planned is None else "fresh measured pose"
            raise RefusalError("no_data", f"There is no {missing}, so no placement can be saved.")
        return await self._write("placement", "yaml", placement_text(planned, measured))

    def log_poses(self) -> asyncio.Task[Path]:
        """Start a log of `LOG_SECONDS` at `LOG_RATE_HZ`; return its task, whose result is the file.

        Raises:
            RefusalError: A log is being taken, or nothing is registered, so that no pose in the image is known.
        """
        if self._core.registration() is None:
            raise RefusalError("no_data", "There is no registration, so no poses in the image can be logged: register.")
        if self._log is not None and not self._log.done():
            raise RefusalError("busy", f"A pose log is being taken; it ends within {LOG_SECONDS:g} s.")
        self._log = self._tasks.spawn(self._take_log())
        return self._log

    async def _take_log(self) -> Path:
        began = self._clock.monotonic()
        rows = []
        for sample in range(round(LOG_SECONDS * LOG_RATE_HZ) + 1):
            await self._clock.sleep(began + sample / LOG_RATE_HZ - self._clock.monotonic())
            tracked = self._core.tracked()
            if tracked is not None:  # a body that the tracker does not see leaves a gap, not an old pose
                rows.append(sample_rows(tracked))
        return await self._write("poses", "csv", "".join(rows))

    async def _write(self, kind: str, suffix: str, text: str) -> Path:
        stamp = datetime.fromtimestamp(self._clock.wall()).strftime("%Y%m%d_%H%M%S_%f")
        path = self._folder / f"{kind}_{stamp}.{suffix}"
        await asyncio.to_thread(_write_whole, path, text)
        return path


def placement_text(planned: Transform, measured: Transform) -> str:
    """Return the YAML text of a placement.

    Args:
        planned: Planned ``image_from_coil``, m.
        measured: Measured ``image_from_coil``, m.
    """
    return _pose_block("PLANNED_POSE", planned) + _pose_block("MEASURED_POSE", measured)


def sample_rows(tracked: TrackedPoses) -> str:
    """Return the CSV rows of one sample: name, x, y, z, qx, qy, qz, qw."""
    poses = {
        "body_tool": tracked.image_from_tool,
        "pol_body": tracked.tracker_from_image,
        "pol_tool": tracked.tracker_from_tool,
    }
    lines = []
    for row, pose in poses.items():
        lines.append(",".join([row, *(f"{number:.6f}" for number in (*pose.translation, *pose.quat_xyzw))]))
    return "\n".join(lines) + "\n"


def _pose_block(title: str, pose: Transform) -> str:
    translation = _mapping("xyz", pose.translation.tolist())
    rotation = _mapping("xyzw", pose.quat_xyzw.tolist())
    return (
        f"{title}:\n  {{\n"
        f"    TRANSLATION: # translation: x,y,z\n{translation},\n"
        f"    ROTATION: # quat: x,y,z,w\n{rotation}\n"
        "  }\n"
    )


def _mapping(names: str, numbers: list[float]) -> str:
    lines = ",\n".join(f"      {name}: {number:.16f}" for name, number in zip(names, numbers, strict=True))
    return f"    {{\n{lines}\n    }}"


def _write_whole(path: Path, text: str) -> None:
    """Write a file so that a reader sees the complete file under its name, or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    with part.open("w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)
