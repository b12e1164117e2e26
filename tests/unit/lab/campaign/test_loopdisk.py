"""A disk of a campaign: what fills it, who sees its errors, and that it is removed whatever happens."""

from __future__ import annotations

import errno
import os
import resource
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from pcmrs_lab.campaign import loopdisk
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.loopdisk import MEBIBYTES, LoopDisk, loop_disk
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import run

ROOM = (2 << 20) + 5000
"""Space on a disk of a test, bytes."""


@pytest.fixture
def disk(tmp_path: Path) -> LoopDisk:
    return LoopDisk(tmp_path, tmp_path / "disk.ext4")


@pytest.fixture
def full_at() -> Iterator[None]:
    """Lets no file of this process grow beyond the room of the disk, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.usefixtures("full_at")
@pytest.mark.parametrize("leaving", [0, 4096])
def test_all_space_is_taken_except_what_is_left(disk: LoopDisk, leaving: int) -> None:
    disk.fill(leaving)
    assert (disk.path / loopdisk.RESERVE).stat().st_size == ROOM - leaving
    disk.release()
    assert not list(disk.path.iterdir())
    disk.release()


def test_no_space_is_taken_in_a_sham_campaign(disk: LoopDisk) -> None:
    with sham():
        disk.fill()
    assert not list(disk.path.iterdir())


def test_another_program_sees_the_error_of_the_disk(disk: LoopDisk, monkeypatch: pytest.MonkeyPatch) -> None:
    assert disk.error() == ""

    def fail(_: int) -> None:
        raise OSError(errno.EROFS, "Read-only")

    monkeypatch.setattr(os, "fsync", fail)
    assert disk.error() == "EROFS"
    assert not list(disk.path.iterdir()), "nothing of the probe stays"


def test_the_used_share_is_that_which_is_not_available(disk: LoopDisk, monkeypatch: pytest.MonkeyPatch) -> None:
    counted = os.statvfs_result((4096, 4096, 1000, 400, 250, 0, 0, 0, 0, 255))
    monkeypatch.setattr(os, "statvfs", lambda _: counted)
    assert disk.used_share() == 0.75


def test_the_power_is_cut_only_in_a_campaign(disk: LoopDisk, monkeypatch: pytest.MonkeyPatch) -> None:
    requests: list[int] = []
    monkeypatch.setattr("fcntl.ioctl", lambda _file, request, _argument: requests.append(request))
    with sham():
        disk.cut_power()
    assert requests == []
    disk.cut_power()
    assert requests == [loopdisk.SHUTDOWN]


class Tools:
    """Commands that are run; an unmounting is refused so often."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, busy: int = 0) -> None:
        self.run: list[list[str]] = []
        self.busy = busy
        monkeypatch.setattr(loopdisk, "tool", self.tool)

    async def tool(self, words: Sequence[str]) -> str:
        self.run.append(list(words))
        if words[0] == "umount" and words[1] != "-l" and self.busy:
            self.busy -= 1
            raise NotRun("The disk is busy.")
        return ""

    @property
    def names(self) -> list[str]:
        return [words[0] for words in self.run]


async def test_a_disk_is_made_mounted_and_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = Tools(monkeypatch)
    async with loop_disk(tmp_path) as made:
        assert tools.names == ["mkfs.ext4", "mount"]
        assert made.image.stat().st_size == MEBIBYTES << 20
        await made.power_on()
    assert tools.names == ["mkfs.ext4", "mount", "umount", "mount", "umount"]
    assert tools.run[1][1:] == tools.run[3][1:] == ["-o", "loop,errors=remount-ro", str(made.image), str(made.path)]


async def test_it_is_removed_after_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = Tools(monkeypatch)
    with pytest.raises(KeyError):
        async with loop_disk(tmp_path):
            raise KeyError
    assert tools.names[-1] == "umount"


def test_a_disk_that_is_held_for_a_while_is_unmounted_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = Tools(monkeypatch, busy=3)
    run(monkeypatch, loopdisk._unmount(tmp_path))
    assert tools.run == [["umount", str(tmp_path)]] * 4
    tools = Tools(monkeypatch, busy=1000)
    run(monkeypatch, loopdisk._unmount(tmp_path))
    assert tools.run[-1] == ["umount", "-l", str(tmp_path)], "no test leaves a disk behind"


async def test_a_disk_is_made_read_only_only_in_a_campaign(disk: LoopDisk, monkeypatch: pytest.MonkeyPatch) -> None:
    tools = Tools(monkeypatch)
    with sham():
        await disk.make_read_only()
    assert tools.run == []
    await disk.make_read_only()
    assert tools.run == [["mount", "-o", "remount,abort", str(disk.path)]]
