"""The disk of the journal: its file system, the time of an fsync, and its free space."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.doctor._disk import assess_times, disk, free_space
from tests.unit.doctor.machines import only


@pytest.mark.parametrize(("kind", "verdict"), [("ext4", "good"), ("tmpfs", "warning"), ("nfs4", "bad")])
def test_journal_disk_is_judged_by_its_file_system(tmp_path: Path, kind: str, verdict: str) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(f"/dev/root / ext4 rw 0 0\nthere {tmp_path.resolve()} {kind} rw 0 0\n")
    folder = tmp_path / "not" / "yet" / "made"

    assert only(disk(folder, mounts), "journal's disk").verdict == verdict
    assert not folder.parent.parent.exists()


@pytest.mark.parametrize(("longest", "verdict"), [(0.004, "good"), (0.2, "warning"), (1.5, "bad")])
def test_the_time_of_fsync_is_judged_by_the_longest(longest: float, verdict: str) -> None:
    found = assess_times([0.002] * 49 + [longest])
    assert found.verdict == verdict
    assert f"{longest * 1e3:.2g} ms" in found.found


@pytest.mark.parametrize(
    ("warn", "floor", "verdict"), [(0.0, 0.0, "good"), (1e18, 0.0, "warning"), (1e18, 1e18, "bad")]
)
def test_free_space_is_compared_with_the_daemon_s_limits(
    tmp_path: Path, warn: float, floor: float, verdict: str
) -> None:
    assert only(free_space(tmp_path, warn, floor), "free space").verdict == verdict
