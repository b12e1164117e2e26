"""Saved placements and pose logs: whole files that read back."""

from __future__ import annotations

import csv
import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given

from pcmrs.background import BackgroundTasks
from pcmrs.errors import RefusalError
from pcmrs.gateway.pose_files import PoseFileWriter, placement_text
from pcmrs.spatial import Transform
from tests.unit.gateway.gateway_fakes import POINTS, POSE, ROTVECS, FakeCore, ManualClock


@given(POINTS, ROTVECS)
def test_a_saved_placement_reads_back(position: tuple[float, ...], rotvec: tuple[float, ...]) -> None:
    planned = Transform.from_rotvec(position, rotvec)
    content = yaml.safe_load(placement_text(planned, POSE))
    assert list(content) == ["PLANNED_POSE", "MEASURED_POSE"]
    read = content["PLANNED_POSE"]
    np.testing.assert_allclose([read["TRANSLATION"][axis] for axis in "xyz"], planned.translation, atol=1e-15)
    np.testing.assert_allclose([read["ROTATION"][axis] for axis in "xyzw"], planned.quat_xyzw, atol=1e-15)


async def test_a_pose_log_holds_five_seconds_at_twenty_hertz(tmp_path: Path) -> None:
    core, clock, tasks = FakeCore(), ManualClock(), BackgroundTasks()
    pose_files = PoseFileWriter(core, clock, tmp_path / "session", tasks)
    with pytest.raises(RefusalError, match="no registration"):
        pose_files.log_poses()
    core.registered = POSE
    began = clock.now
    log = pose_files.log_poses()
    with pytest.raises(RefusalError, match="being taken"):
        pose_files.log_poses()
    path = await log
    assert clock.now - began == pytest.approx(5.0)
    rows = list(csv.reader(path.read_text().splitlines()))
    assert [row[0] for row in rows] == ["body_tool", "pol_body", "pol_tool"] * 101
    assert {len(row) for row in rows} == {8}
    assert list(path.parent.iterdir()) == [path]
    await tasks.close()


async def test_a_placement_without_a_measured_pose_is_not_saved(tmp_path: Path) -> None:
    core = FakeCore()
    pose_files = PoseFileWriter(core, ManualClock(), tmp_path, BackgroundTasks())
    assert (await pose_files.save_placement()).suffix == ".yaml"
    core.pose = None
    with pytest.raises(RefusalError, match="no fresh measured pose"):
        await pose_files.save_placement()


async def test_a_record_gets_its_name_when_the_disk_has_all_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, synced = os.fsync, []

    def look(descriptor: int) -> None:
        sync(descriptor)
        synced.append((os.fstat(descriptor).st_size, [path.suffix for path in tmp_path.iterdir()]))

    monkeypatch.setattr(os, "fsync", look)
    path = await PoseFileWriter(FakeCore(), ManualClock(), tmp_path, BackgroundTasks()).save_placement()
    assert synced == [(path.stat().st_size, [".part"])]
    assert path.suffix == ".yaml"
