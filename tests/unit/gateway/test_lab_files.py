"""The lab's files during a procedure: what the lab's modules compute from them, and a disk that is slow or gone."""

from __future__ import annotations

import asyncio
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml

from pcmrs.background import BackgroundTasks
from pcmrs.errors import ConfigurationError
from pcmrs.files import keep_private, write_durably
from pcmrs.formats.lab_text import IN_FORCE
from pcmrs.formats.reading import MAX_TEXT_BYTES
from pcmrs.gateway import _lab_files
from pcmrs.gateway._lab_files import NOT_WRITTEN, STUCK, STUCK_AFTER, LabFileWriter
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.rejection_log import RejectionLog
from pcmrs.gateway.settings import GatewayConfig, LinkConfig
from pcmrs.spatial import Floats, Transform
from pcmrs.testing.clock import ManualClock as SteppedClock
from pcmrs.testing.clock import settle
from pcmrs.workflows.data import Landmark, PlacementData, Point, Registered, as_message, as_point
from tests import ROOT
from tests.unit.gateway.gateway_fakes import WITHIN, FakeCore, ManualClock

REG = Transform.from_rotvec((0.08, -0.03, -0.23), (0.4, 1.1, -0.7))
PLAN = Transform.from_rotvec((0.02, 0.05, 0.11), (0.1, -0.6, 0.3))
PLANNED: tuple[Point, ...] = ((0.004, 0.086, 0.04), (-0.046, 0.069, 0.035), (-0.079, -0.008, 0.019), (0.09, 0.0, 0.02))
LANDMARKS = tuple(Landmark(f"landmark {index}", point) for index, point in enumerate(PLANNED))
ENDS_WITHIN = 40.0
"""Longest run of a program that ends by itself, s."""
ERRORS_MM = (1.0, 2.0, 0.5, 3.0)
DIGITIZED = tuple(
    as_point((REG @ np.array(point)) + (0.0, 0.0, error / 1000.0))
    for point, error in zip(PLANNED, ERRORS_MM, strict=True)
)
SURFACE: tuple[Point, ...] = ((0.157068, 0.013933, -0.072968), (0.158766, -0.003591, -0.05939))
PLANNED_DATA = PlacementData(landmarks=LANDMARKS, digitized=(None,) * 4)


def registered(**more: Any) -> PlacementData:
    found = Registered(
        id="r",
        body_ref_from_image=as_message(REG),
        residual=0.0,
        rms=0.0,
        landmarks=LANDMARKS,
        digitized=DIGITIZED,
        patient="",
        calibration="",
        **more,
    )
    return msgspec.structs.replace(PLANNED_DATA, digitized=DIGITIZED, registered=found)


class Writer:
    """The writer before a fake daemon, with its folder."""

    def __init__(self, folder: Path) -> None:
        self.core, self.folder, self.clock = FakeCore(), folder, SteppedClock()
        self.tasks, self.reports = BackgroundTasks(), BackgroundTasks()
        refusals = RejectionLog(self.core, ManualClock(), self.reports)
        self.writer = LabFileWriter(self.core, self.clock, folder, self.tasks, refusals)
        self.core.add_listener(self.writer)
        self.writer.start()

    def change(self, data: PlacementData) -> None:
        self.core.placement_data = data
        self.core.publish(self.core.snapshot())

    async def settle(self) -> None:
        async with asyncio.timeout(WITHIN):
            await self.tasks.wait()

    def content(self, name: str) -> dict[str, Any]:
        found: dict[str, Any] = yaml.safe_load((self.folder / name).read_text())
        return found


@asynccontextmanager
async def a_writer(folder: Path) -> AsyncIterator[Writer]:
    writer = Writer(folder)
    yield writer
    await writer.settle()
    await writer.reports.close()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def mode_of(path: Path) -> int:
    return path.stat().st_mode & 0o777


def inodes(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_ino for path in folder.iterdir()}


def fre_mm(writer: Writer) -> Floats:
    """FRE of each landmark as the lab's module computes it for its button "Visualize FRE"."""
    plan, dig, reg = (writer.content(f"{name}.yaml") for name in ("landmarkplan", "landmarkdig", "reg"))
    assert plan["NUM"] == dig["NUM"]
    planned = np.array([[plan["PLANNED"][f"p{i}"][axis] * 1000.0 for axis in "xyz"] for i in range(plan["NUM"])])
    digitized = np.array([[dig["DIGITIZED"][f"d{i}"][axis] * 1000.0 for axis in "xyz"] for i in range(dig["NUM"])])
    rotation, position = module_pose(reg)
    distances: Floats = np.linalg.norm((digitized - position) @ rotation - planned, axis=1)
    return distances


def module_pose(content: dict[str, Any]) -> tuple[Floats, Floats]:
    """Rotation matrix and position in mm, by the module's formula."""
    x, y, z, w = (content["ROTATION"][axis] for axis in "xyzw")
    rotation = [
        [1 - 2 * y * y - 2 * z * z, 2 * x * y - 2 * z * w, 2 * x * z + 2 * y * w],
        [2 * x * y + 2 * z * w, 1 - 2 * x * x - 2 * z * z, 2 * y * z - 2 * x * w],
        [2 * x * z - 2 * y * w, 2 * y * z + 2 * x * w, 1 - 2 * x * x - 2 * y * y],
    ]
    return np.array(rotation), np.array([content["TRANSLATION"][axis] * 1000.0 for axis in "xyz"])


async def test_the_modules_buttons_work_on_the_files(tmp_path: Path) -> None:
    async with a_writer(tmp_path) as writer:
        await writer.settle()
        assert names(tmp_path) == [], "nothing is planned yet"
        for data in (PLANNED_DATA, registered(), msgspec.structs.replace(registered(), plan=as_message(PLAN))):
            writer.change(data)
        await writer.settle()
        np.testing.assert_allclose(fre_mm(writer), ERRORS_MM, atol=1e-9)
        assert writer.content("reg.yaml")["FLAG_ICP"] == 0
        rotation, position = module_pose(writer.content("toolpose.yaml"))  # "Retrieve tool pose"
        np.testing.assert_allclose(rotation, PLAN.rotation, atol=1e-12)
        np.testing.assert_allclose(position, PLAN.translation * 1000.0, atol=1e-9)

        refined = msgspec.structs.replace(registered(covariance=(1.0,) * 36), surface=SURFACE)
        writer.change(refined)
        await writer.settle()
        clouds = writer.content("icpdig.yaml")  # "Show ICP"
        numbers = [float(part) for cloud in clouds.values() for part in cloud.strip().split(",")[:-1]]
        np.testing.assert_allclose(np.reshape(numbers, (-1, 3)), SURFACE, atol=1e-6)
        assert writer.content("reg.yaml")["FLAG_ICP"] == 1


async def test_open_landmarks_are_not_a_number_until_digitized(tmp_path: Path) -> None:
    async with a_writer(tmp_path) as writer:
        writer.change(msgspec.structs.replace(PLANNED_DATA, digitized=(DIGITIZED[0], None, None, None)))
        await writer.settle()
        content = writer.content("landmarkdig.yaml")["DIGITIZED"]
        assert [content["d0"][axis] for axis in "xyz"] == pytest.approx(DIGITIZED[0])
        assert np.isnan(content["d3"]["x"])


async def test_what_is_revoked_says_so_and_stays(tmp_path: Path) -> None:
    async with a_writer(tmp_path) as writer:
        writer.change(msgspec.structs.replace(registered(), plan=as_message(PLAN), surface=SURFACE))
        await writer.settle()
        assert (writer.content("reg.yaml")["IN_FORCE"], writer.content("toolpose.yaml")["IN_FORCE"]) == (1, 1)
        writer.change(msgspec.structs.replace(PLANNED_DATA, plan=as_message(PLAN)))
        await writer.settle()
        assert (writer.content("reg.yaml")["IN_FORCE"], writer.content("toolpose.yaml")["IN_FORCE"]) == (0, 1)
        assert (tmp_path / "icpdig.yaml").read_text() == ""
        writer.change(msgspec.structs.replace(registered(), plan=as_message(PLAN)))
        await writer.settle()
        assert writer.content("reg.yaml")["IN_FORCE"] == 1
    async with a_writer(tmp_path) as again:
        await again.settle()
        assert again.content("toolpose.yaml")["IN_FORCE"] == 0, "of an earlier run of the daemon"
        np.testing.assert_allclose(module_pose(again.content("toolpose.yaml"))[1], PLAN.translation * 1000.0, atol=1e-9)


@pytest.mark.parametrize(("folder", "file"), [(0o700, 0o600), (0o750, 0o640), (0o755, 0o644)], ids=oct)
async def test_who_may_read_the_folder_may_read_the_files(tmp_path: Path, folder: int, file: int) -> None:
    os.chmod(tmp_path, folder)  # noqa: PTH101  # its method counts as blocking
    before = keep_private()
    try:
        async with a_writer(tmp_path) as writer:
            writer.change(PLANNED_DATA)
    finally:
        os.umask(before)
    assert mode_of(tmp_path / "landmarkplan.yaml") == file


async def test_files_that_the_lab_has_written_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "reg.yaml").write_text("TRANSLATION: {x: 0, y: 0, z: 0}\n")
    (tmp_path / "icpdig.yaml").write_text('points0: "1,2,3,"\n')
    before = inodes(tmp_path)
    async with a_writer(tmp_path) as writer:
        writer.change(PLANNED_DATA)
        await writer.settle()
    assert before.items() <= inodes(tmp_path).items()


async def test_a_slow_disk_holds_up_nobody_and_gets_the_newest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync, slow, started = os.fsync, threading.Event(), threading.Event()

    def wait(descriptor: int) -> None:
        started.set()
        slow.wait(WITHIN)
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", wait)
    async with a_writer(tmp_path) as writer:
        writer.change(PLANNED_DATA)
        assert await asyncio.to_thread(started.wait, WITHIN)
        for index in range(1, 5):
            points = (*DIGITIZED[:index], *(None,) * (4 - index))
            writer.change(msgspec.structs.replace(PLANNED_DATA, digitized=points))
        assert not (tmp_path / "landmarkplan.yaml").exists(), "the disk has not ended, and the loop went on"
        slow.set()
        await writer.settle()
        dig = writer.content("landmarkdig.yaml")["DIGITIZED"]
        assert [dig["d3"][axis] for axis in "xyz"] == pytest.approx(DIGITIZED[3])


async def test_what_cannot_be_written_is_reported_and_written_later(tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    folder.mkdir()
    async with a_writer(folder) as writer:
        await writer.settle()
        shutil.rmtree(folder)
        writer.change(PLANNED_DATA)
        await writer.settle()
        (event,) = writer.core.events
        assert event.fields["reason"] == NOT_WRITTEN
        assert "No such file" in event.text
        folder.mkdir()
        writer.change(registered())
        await writer.settle()
        np.testing.assert_allclose(fre_mm(writer), ERRORS_MM, atol=1e-9)


async def test_a_stuck_disk_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sync, stuck, started = os.fsync, threading.Event(), threading.Event()

    def wait(descriptor: int) -> None:
        started.set()
        stuck.wait(WITHIN)
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", wait)
    async with a_writer(tmp_path) as writer:
        writer.change(PLANNED_DATA)
        assert await asyncio.to_thread(started.wait, WITHIN)
        await settle()
        assert writer.core.events == []
        await writer.clock.advance(STUCK_AFTER)
        await settle()
        (event,) = writer.core.events
        assert event.fields["reason"] == STUCK
        assert f"{tmp_path} has not been written for 5 s" in event.text
        stuck.set()
        await writer.settle()
        assert writer.content("landmarkplan.yaml")["NUM"] == len(PLANNED)
        assert len(writer.core.events) == 1


async def test_an_end_during_a_write_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck, started = threading.Event(), threading.Event()

    def wait(_: int) -> None:
        started.set()
        stuck.wait(WITHIN)

    monkeypatch.setattr(os, "fsync", wait)
    async with a_writer(tmp_path) as writer:
        writer.change(PLANNED_DATA)
        assert await asyncio.to_thread(started.wait, WITHIN)
        await settle()
        await writer.tasks.close()
        (event,) = writer.core.events
        assert event.fields["reason"] == STUCK
        stuck.set()


STUCK_PROGRAM = """
import asyncio, os, sys, time
from pathlib import Path
from pcmrs.clock import SystemClock
from pcmrs.gateway.links import open_gateway
from tests.unit.gateway.gateway_fakes import FakeCore
from tests.unit.gateway.test_lab_files import config, registered

async def main(folder):
    core = FakeCore()
    async with open_gateway(core, config(folder / "lab"), SystemClock(), folder):
        core.placement_data = registered()
        core.publish(core.snapshot())

os.fsync = lambda _: time.sleep(1000.0)
asyncio.run(main(Path(sys.argv[1])))
"""


def test_a_stuck_disk_does_not_keep_the_process_from_ending(tmp_path: Path) -> None:
    program = [sys.executable, "-c", STUCK_PROGRAM, str(tmp_path)]
    subprocess.run(program, cwd=ROOT, check=True, timeout=ENDS_WITHIN)


def a_pipe(path: Path) -> None:
    os.mkfifo(path)


def a_link(path: Path) -> None:
    other = path.with_name("other.yaml")
    other.write_text(f"secret: 1\n{IN_FORCE}")
    path.symlink_to(other)


def a_large_file(path: Path) -> None:
    path.write_text(" " * MAX_TEXT_BYTES + IN_FORCE)


@pytest.mark.parametrize("put", [a_pipe, a_link, a_large_file])
async def test_what_no_daemon_has_written_is_not_read(tmp_path: Path, put: Callable[[Path], None]) -> None:
    put(tmp_path / "reg.yaml")
    before = (tmp_path / "reg.yaml").lstat()
    async with a_writer(tmp_path) as writer:
        writer.change(PLANNED_DATA)
        await writer.settle()
        assert writer.content("landmarkplan.yaml")["NUM"] == len(PLANNED)
        assert (tmp_path / "reg.yaml").lstat() == before
        assert {event.fields["reason"] for event in writer.core.events} == {NOT_WRITTEN}
        assert "reg.yaml cannot be read or replaced" in writer.core.events[0].text


async def test_a_link_gives_nobody_the_rights_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Someone who may write into the folder exchanges a file for a link as soon as it is there."""
    folder, secret = tmp_path / "lab", tmp_path / "secret"
    folder.mkdir(mode=0o777)
    secret.write_text("key")
    secret.chmod(0o600)

    def exchange(path: Path, *arguments: Any, **options: Any) -> None:
        write_durably(path, *arguments, **options)
        path.unlink()
        path.symlink_to(secret)

    monkeypatch.setattr(_lab_files, "write_durably", exchange)
    async with a_writer(folder) as writer:
        writer.change(PLANNED_DATA)
        await writer.settle()
    assert mode_of(secret) == 0o600


async def test_a_file_that_fails_keeps_no_other_from_its_truth(tmp_path: Path) -> None:
    async with a_writer(tmp_path) as writer:
        writer.change(registered())
        await writer.settle()
        (tmp_path / "landmarkdig.yaml").unlink()
        (tmp_path / "landmarkdig.yaml").mkdir()
        points = (DIGITIZED[0], None, None, None)
        writer.change(msgspec.structs.replace(PLANNED_DATA, digitized=points, surface=SURFACE))
        await writer.settle()
        assert writer.content("reg.yaml")["IN_FORCE"] == 0
        assert writer.content("icpdig.yaml"), "it is written after the one that fails"
        (event,) = writer.core.events
        assert event.text.startswith(f"{tmp_path / 'landmarkdig.yaml'} cannot be read or replaced (Is a directory)")


async def test_revocations_are_written_before_all_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order: list[str] = []
    replace = LabFileWriter._replace

    def note(self: LabFileWriter, name: str, text: str) -> None:
        order.append(name)
        replace(self, name, text)

    async with a_writer(tmp_path) as writer:
        writer.change(msgspec.structs.replace(registered(), plan=as_message(PLAN)))
        await writer.settle()
        monkeypatch.setattr(LabFileWriter, "_replace", note)
        writer.change(PlacementData(landmarks=LANDMARKS[:3], digitized=(None,) * 3))
        await writer.settle()
    assert order == ["reg.yaml", "toolpose.yaml", "landmarkplan.yaml", "landmarkdig.yaml"]


def config(folder: Path) -> GatewayConfig:
    none = LinkConfig()
    return GatewayConfig(
        planner=none, robot=none, visualization=none, mixed_reality=none, mep=none, lab_files=str(folder)
    )


async def test_the_gateway_writes_the_last_change_before_it_ends(tmp_path: Path) -> None:
    core = FakeCore()
    async with open_gateway(core, config(tmp_path / "new" / "lab"), ManualClock(), tmp_path):
        core.placement_data = registered()
        core.publish(core.snapshot())
    assert names(tmp_path / "new" / "lab") == ["landmarkdig.yaml", "landmarkplan.yaml", "reg.yaml"]


async def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match=r"gateway\.lab_files.*give a folder"):
        async with open_gateway(FakeCore(), config(tmp_path / "file" / "lab"), ManualClock(), tmp_path):
            pass
