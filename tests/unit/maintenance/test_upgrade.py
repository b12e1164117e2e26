"""Upgrade of a folder: complete, or not at all, whatever interrupts it; the old folder is kept as it was."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.failpoints import UPGRADE_FAILPOINTS, VARIABLE
from pcmrs.journal import JournalReader, StoredRow, verify
from pcmrs.journal.head import head_path
from pcmrs.maintenance import back_up, check_folder, enter_folder, hold_folder, restore, upgrade_folder
from tests import ROOT
from tests.unit.maintenance.labs import Lab, contents

BEFORE_EXCHANGE = UPGRADE_FAILPOINTS[: UPGRADE_FAILPOINTS.index("upgrade.after_exchange")]
JOURNAL_FAILPOINTS = ("journal.before_begin", "journal.before_commit", "journal.after_commit", "journal.after_head")


def rows(journal: Path) -> list[StoredRow]:
    with JournalReader(journal) as reader:
        return list(reader.read_whole())


def upgrade(lab: Lab) -> Path:
    """Upgrade the lab's cell; return the folder that was kept."""
    kept = upgrade_folder(lab.cell, SystemClock().wall()).kept
    assert kept is not None
    return Path(kept)


def upgrade_process(
    lab: Lab, *, failpoint: str = "", largest: int | None = None, prefix: Sequence[str] = ()
) -> subprocess.CompletedProcess[str]:
    """Run `pcmrs upgrade`, which dies at a failpoint, or whose files may have at most `largest` bytes.

    Args:
        lab: Lab whose cell is upgraded.
        failpoint: Place and number at which the process dies.
        largest: Largest size of a file, bytes.
        prefix: Words before the command: a program that runs it.
    """

    def limit() -> None:
        if largest is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))

    return subprocess.run(
        [*prefix, sys.executable, "-m", "pcmrs.cli", "upgrade", str(lab.cell)],
        env={**os.environ, VARIABLE: failpoint},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
    )


def test_the_first_version_is_upgraded_without_loss(first: Lab) -> None:
    before, old_rows = contents(first.cell), rows(first.journal)
    assert verify(first.journal).sound
    kept = upgrade(first)

    assert contents(kept) == before
    assert check_folder(first.cell).action == "use"
    enter_folder(first.cell)
    found = verify(first.journal, kept=head_path(kept / first.journal.name))
    assert (found.version, found.unnamed, found.problems) == (3, 0, ())
    new_rows = rows(first.journal)
    assert new_rows[: len(old_rows)] == old_rows
    assert [stored.row.operation for stored in new_rows[len(old_rows) :]] == ["mac_begun"]
    after = contents(first.cell)
    same = before.keys() - {"ratms.sqlite", "ratms.sqlite.head"}
    assert {name: after[name] for name in same} == {name: before[name] for name in same}
    assert after.keys() - before.keys() == {"cell.json"}
    assert (first.cell / "journal.key").stat().st_mode & 0o777 == 0o600


def test_what_this_version_wrote_stays_as_it_is(present: Lab) -> None:
    before = contents(present.folder)
    report = upgrade_folder(present.cell, SystemClock().wall())
    assert (report.kept, report.upgraded) == (None, ())
    assert contents(present.folder) == before


def test_second_upgrade_changes_nothing(first: Lab) -> None:
    upgrade(first)
    before = contents(first.folder)
    assert upgrade_folder(first.cell, SystemClock().wall()).kept is None
    assert contents(first.folder) == before


@pytest.mark.parametrize("failpoint", [*UPGRADE_FAILPOINTS, *JOURNAL_FAILPOINTS])
def test_a_kill_leaves_the_folder_usable_and_is_repeated(first: Lab, failpoint: str) -> None:
    before = contents(first.cell)
    killed = upgrade_process(first, failpoint=f"{failpoint}:1")
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert verify(first.journal).sound
    if failpoint in (*BEFORE_EXCHANGE, *JOURNAL_FAILPOINTS):
        assert contents(first.cell) == before
    else:
        enter_folder(first.cell)

    repeated = upgrade_process(first)
    assert repeated.returncode == 0, repeated.stderr
    assert check_folder(first.cell).action == "use"
    assert verify(first.journal).sound
    (kept,) = first.folder.glob("cell.before-*")
    assert contents(kept) == before
    beside = {path.name for path in first.folder.iterdir() if path.name.startswith("cell")}
    assert beside == {"cell", kept.name, "cell.toml", "cell1"}
    assert not (first.cell / "unfinished-upgrade").exists()


def check_unchanged(lab: Lab, before: dict[str, bytes], failed: subprocess.CompletedProcess[str]) -> None:
    """Require that a failed upgrade said so and left nothing, and that a second one succeeds."""
    assert failed.returncode in (4, 5), failed.stdout
    assert "upgrade: " in failed.stderr
    assert "Traceback" not in failed.stderr
    assert "acknowledged any more" not in failed.stderr or "the old folder is unchanged" in failed.stderr
    assert contents(lab.folder) == before
    upgrade(lab)
    assert check_folder(lab.cell).action == "use"


@pytest.mark.parametrize("largest", [0, 20_000, 40_000])
def test_files_that_cannot_grow_change_nothing(first: Lab, largest: int) -> None:
    before = contents(first.folder)
    check_unchanged(first, before, upgrade_process(first, largest=largest))


@pytest.mark.timeout(300)  # strace stops the process at many system calls
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace has system calls fail")
@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("ratms.sqlite", "pwrite64"),
        ("ratms.sqlite-wal", "pwrite64"),
        ("ratms.sqlite-wal", "fdatasync"),
        ("ratms.sqlite.head", "pwrite64"),
        ("ratms.sqlite.head", "fsync"),
        ("peers.counters", "sendfile"),
        ("cell.json.part", "write"),
    ],
)
def test_a_full_disk_at_any_file_changes_nothing(first: Lab, name: str, call: str) -> None:
    before = contents(first.folder)
    place = first.folder / ".cell.pcmrs-unfinished" / name
    inject = ["-e", f"trace={call}", "-e", f"inject={call}:error=ENOSPC:when=1", "-P", str(place)]
    words = ["strace", "-f", "--seccomp-bpf", "-qq", "-o", str(first.folder.with_name("calls")), *inject]
    failed = upgrade_process(first, prefix=words)
    assert "ENOSPC" in first.folder.with_name("calls").read_text()
    check_unchanged(first, before, failed)


def test_a_folder_whose_daemon_runs_is_not_upgraded(first: Lab) -> None:
    before = contents(first.folder)
    with hold_folder(first.cell), pytest.raises(ConfigurationError, match="Another daemon runs this cell"):
        upgrade(first)
    assert contents(first.folder) == before


def test_a_refused_file_stops_the_upgrade_before_it_starts(version_2_behind: Lab) -> None:
    before = contents(version_2_behind.folder)
    with pytest.raises(ConfigurationError, match="is not upgraded, and is unchanged"):
        upgrade(version_2_behind)
    assert contents(version_2_behind.folder) == before


def test_recordings_are_not_copied_but_linked(first: Lab) -> None:
    (recording,) = (first.cell / "recordings").glob("*.mcap")
    number = recording.stat().st_ino
    kept = upgrade(first)
    assert recording.stat().st_ino == number == (kept / "recordings" / recording.name).stat().st_ino


@pytest.mark.parametrize("lab", ["first", "present"])
def test_a_folder_above_a_running_cell_is_not_upgraded(lab: str, request: pytest.FixtureRequest) -> None:
    """Its own lock is free, and the rows in the log of the journal below would not be copied."""
    written: Lab = request.getfixturevalue(lab)
    above = written.folder
    above.chmod(0o755)
    before, number = sorted(above.rglob("*")), above.stat().st_ino
    with (
        hold_folder(written.cell),
        pytest.raises(ConfigurationError, match=r"not the folder of one cell: it has cell/.* below it"),
    ):
        upgrade_folder(above, SystemClock().wall())
    assert (sorted(above.rglob("*")), above.stat().st_ino) == (before, number)
    assert above.stat().st_mode & 0o777 == 0o755
    assert [path.name for path in above.parent.iterdir()] == [above.name]


def test_a_marked_folder_above_a_cell_is_not_upgraded(first: Lab) -> None:
    """A daemon with the folder above as its cell.folder has marked it."""
    enter_folder(first.folder)
    before = contents(first.folder)
    with pytest.raises(ConfigurationError, match=r"cell/ratms.sqlite below it"):
        upgrade_folder(first.folder, SystemClock().wall())
    assert contents(first.folder) == before


def test_a_backup_is_not_upgraded_and_can_be_restored(first: Lab, tmp_path: Path) -> None:
    backup = tmp_path / "monday"
    back_up(first.cell, backup, SystemClock().wall())
    before = contents(tmp_path)
    (refused,) = check_folder(backup).refused
    assert "is a backup, which stays as it is" in refused.text
    with pytest.raises(ConfigurationError, match=r"is a backup.*pcmrs restore"):
        upgrade_folder(backup, SystemClock().wall())
    assert contents(tmp_path) == before
    assert not (backup / "lock").exists()
    restore(backup, tmp_path / "restored")
    assert check_folder(tmp_path / "restored").action == "use"


def test_a_folder_without_a_cell_is_not_upgraded(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir(mode=0o755)
    (tmp_path / "photos" / "one.png").write_bytes(b"1")
    with pytest.raises(ConfigurationError, match=r"it has neither cell\.json nor a journal"):
        upgrade_folder(tmp_path / "photos", SystemClock().wall())
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["one.png", "photos"]
    assert (tmp_path / "photos").stat().st_mode & 0o777 == 0o755
    with pytest.raises(ConfigurationError, match="it has neither"):
        upgrade_folder(tmp_path / "missing", SystemClock().wall())
    assert not (tmp_path / "missing").exists()


def test_links_are_in_the_upgraded_folder(first: Lab) -> None:
    """Recordings on a larger disk, and the key of the journal on another one."""
    disk = first.folder / "disk"
    disk.mkdir()
    (first.cell / "recordings").rename(disk / "recordings")
    (first.cell / "journal.key").rename(disk / "journal.key")
    (first.cell / "recordings").symlink_to("../disk/recordings")
    (first.cell / "journal.key").symlink_to(disk / "journal.key")
    (first.cell / "records" / "gone").symlink_to("/nowhere")
    before, below = contents(disk), contents(first.cell)
    kept = upgrade(first)

    for folder in (first.cell, kept):
        assert (folder / "recordings").readlink() == Path("../disk/recordings")
        assert (folder / "journal.key").readlink() == disk / "journal.key"
        assert (folder / "records" / "gone").readlink() == Path("/nowhere")
    assert contents(disk) == before
    assert contents(kept) == below
    assert verify(first.journal).sound
    assert "recording" in {file.kind for file in check_folder(first.cell).files}


def test_a_linked_journal_is_upgraded_and_its_old_one_kept(first: Lab) -> None:
    disk = first.folder / "disk"
    disk.mkdir()
    for name in ("ratms.sqlite", "ratms.sqlite.head", "journal.pub"):
        (first.cell / name).rename(disk / name)
        (first.cell / name).symlink_to(disk / name)
    before = contents(disk)
    kept = upgrade(first)
    assert contents(disk) == before
    assert not first.journal.is_symlink()
    assert verify(first.journal).version == 3
    assert (kept / "ratms.sqlite").is_symlink()
