"""Control groups of both versions, on a folder in place of the kernel's: set, joined, left and removed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pcmrs_lab.campaign import cgroups
from pcmrs_lab.campaign.cgroups import memory_limit, processor_quota
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import sham


@pytest.fixture
def mounted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A mounted version 2; a folder `cpu` or `memory` makes it a version 1."""
    monkeypatch.setattr(cgroups, "MOUNTED", tmp_path)
    monkeypatch.setattr(Path, "rmdir", remove)
    return tmp_path


def remove(folder: Path) -> None:
    """The kernel removes the files of a group with its folder."""
    for file in folder.iterdir():
        file.unlink()
    os.rmdir(folder)  # noqa: PTH106 - the method is replaced


def group(parent: Path) -> Path:
    (found,) = parent.glob("pcmrs-*")
    return found


def test_version_2_has_one_quota_for_both_policies(mounted: Path) -> None:
    with processor_quota([11, 12], 0.02):
        assert (group(mounted) / "cpu.max").read_text() == "2000 100000"
        assert (group(mounted) / "cgroup.procs").read_text() == "12", "each id is a write of its own"
    assert not list(mounted.glob("pcmrs-*"))


def test_version_1_gives_the_real_time_policy_the_same_share(mounted: Path) -> None:
    (mounted / "cpu").mkdir()
    (mounted / "cpu" / "cpu.rt_runtime_us").touch()
    with processor_quota([11], 0.5):
        own = group(mounted / "cpu")
        settings = ("cpu.cfs_period_us", "cpu.cfs_quota_us", "cpu.rt_runtime_us")
        assert [(own / name).read_text() for name in settings] == ["100000", "50000", "500000"]
        assert not (own / "cpu.max").exists()


def test_a_share_is_never_less_than_the_kernel_allows(mounted: Path) -> None:
    with processor_quota([11], 1e-6):
        assert (group(mounted) / "cpu.max").read_text() == "1000 100000"


@pytest.mark.parametrize("file", ["memory.events", "memory.oom_control"])
def test_kills_for_lack_of_memory_are_those_of_the_kernel(mounted: Path, file: str) -> None:
    with memory_limit([11], 6 << 20) as killed:
        assert (group(mounted) / "memory.max").read_text() == str(6 << 20)
        assert killed() == 0, "a kernel that does not count them"
        (group(mounted) / file).write_text("low 0\noom 3\noom_kill 2\n")
        assert killed() == 2


def test_processes_return_to_the_parent_when_the_limit_ends(mounted: Path) -> None:
    with processor_quota([11], 0.5):
        pass
    assert (mounted / "cgroup.procs").read_text() == "11"


def test_no_process_is_limited_in_a_sham_campaign(mounted: Path) -> None:
    with sham(), processor_quota([11], 0.5):
        assert not (group(mounted) / "cgroup.procs").exists()
        (group(mounted) / "cgroup.procs").touch()


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(30, "Read-only file system")])
def test_groups_that_cannot_be_written_are_not_run(
    mounted: Path, monkeypatch: pytest.MonkeyPatch, error: OSError
) -> None:
    """Containers have them, and mount them read-only."""

    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(NotRun, match="Control groups cannot be written here"), processor_quota([11], 0.5):
        pytest.fail("There is no limit.")


def test_a_process_that_has_ended_meanwhile_fails_its_row(mounted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = Path.write_text

    def ended(path: Path, text: str) -> None:
        if path.name == "cgroup.procs":
            raise ProcessLookupError(3, "No such process")
        write(path, text)

    monkeypatch.setattr(Path, "write_text", ended)
    monkeypatch.setattr(cgroups, "_remove_group", lambda *_: None)
    with pytest.raises(ProcessLookupError), processor_quota([11], 0.5):
        pytest.fail("There is no limit.")


def test_an_error_of_the_fault_itself_is_not_one_of_the_groups(mounted: Path) -> None:
    """It would be reported as not run, and not as failed."""
    with pytest.raises(PermissionError, match="of the fault"), processor_quota([11], 0.5):
        raise PermissionError("of the fault")
    assert not list(mounted.glob("pcmrs-*"))


@pytest.mark.parametrize(
    ("controllers", "folder", "there"),
    [("cpu memory", None, True), ("memory", None, False), (None, "cpu", True), (None, None, False)],
)
def test_need_is_met_by_groups_of_either_version(
    mounted: Path, controllers: str | None, folder: str | None, there: bool
) -> None:
    if controllers is not None:
        (mounted / "cgroup.controllers").write_text(controllers)
    if folder is not None:
        (mounted / folder).mkdir()
    assert cgroups.PROCESSOR[0].is_met() is there
