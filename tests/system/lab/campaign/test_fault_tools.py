"""What faults are injected with does what it says, and to nobody else."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path

import pytest

from pcmrs.testing.needs import Need
from pcmrs.threads import Threads
from pcmrs_lab.campaign import cgroups, loopdisk, syscalls
from pcmrs_lab.campaign.cgroups import processor_quota
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.loopdisk import loop_disk
from pcmrs_lab.campaign.syscalls import injected
from pcmrs_lab.campaign.tools import require

WRITER = """
import os, sys
files = [os.open(name, os.O_WRONLY | os.O_CREAT) for name in sys.argv[1:]]
for line in sys.stdin:
    for file in files:
        try:
            os.write(file, b"x")
            os.fdatasync(file)
            print("written", flush=True)
        except OSError as error:
            print(error.strerror, flush=True)
"""


@asynccontextmanager
async def _writer(*files: Path) -> AsyncIterator[asyncio.subprocess.Process]:
    pipe = asyncio.subprocess.PIPE
    words = (sys.executable, "-c", WRITER, *map(str, files))
    process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)
    try:
        assert await _write(process, len(files)) == ["written"] * len(files)
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _write(process: asyncio.subprocess.Process, answers: int) -> list[str]:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(b"\n")
    return [(await process.stdout.readline()).decode().strip() for _ in range(answers)]


async def test_only_calls_on_the_named_file_fail_while_injected(tmp_path: Path) -> None:
    with _runs_here(syscalls.NEEDS):
        async with _writer(tmp_path / "meant", tmp_path / "other") as process:
            async with injected(process.pid, ("write",), "error=EIO", files=[tmp_path / "meant"]) as tampered:
                assert await _write(process, 2) == ["Input/output error", "written"]
            assert tampered.calls == 1
            assert await _write(process, 2) == ["written", "written"]


async def test_disk_keeps_only_synchronised_data_after_a_power_cut(tmp_path: Path) -> None:
    with _runs_here(loopdisk.NEEDS):
        async with loop_disk(tmp_path) as disk:
            await asyncio.to_thread(_half_synchronised, disk.path / "file")
            disk.cut_power()
            with pytest.raises(OSError, match="Input/output error"):
                (disk.path / "another").write_bytes(b"x")
            await disk.power_on()
            assert (disk.path / "file").read_bytes() == b"kept"
        assert not list((tmp_path / "disk").iterdir())


def _half_synchronised(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        file.write(b"kept")
        os.fsync(file.fileno())
        file.write(b"lost")


async def test_disk_is_full_until_released_and_read_only_until_mounted(tmp_path: Path) -> None:
    with _runs_here(loopdisk.NEEDS):
        async with loop_disk(tmp_path) as disk:
            disk.fill()
            with pytest.raises(OSError, match="No space left"):
                (disk.path / "file").write_bytes(b"x" * 10_000)
            disk.release()
            (disk.path / "file").write_bytes(b"x" * 10_000)
            await disk.make_read_only()
            with pytest.raises(OSError, match="Read-only"):
                (disk.path / "another").write_bytes(b"x")
            await disk.power_on()
            (disk.path / "another").write_bytes(b"x")


def test_a_process_gets_no_more_than_its_share() -> None:
    with _runs_here(cgroups.PROCESSOR):
        burner = "import os\nwhile True: pass"
        with subprocess.Popen([sys.executable, "-c", burner]) as process:
            with processor_quota([process.pid], 0.1):
                first = os.times().elapsed, _ran(process.pid)
                with pytest.raises(subprocess.TimeoutExpired):
                    process.wait(1.0)
                second = os.times().elapsed, _ran(process.pid)
            process.kill()
        assert second[1] - first[1] < 0.25 * (second[0] - first[0])


def _ran(pid: int) -> float:
    return sum(each.ran for each in Threads(pid).times().values())


@contextmanager
def _runs_here(needs: Sequence[Need]) -> Iterator[None]:
    """Skips a test where this machine has not what its tool needs, or does not let it use that."""
    try:
        require(needs)
        yield
    except NotRun as error:
        pytest.skip(error.text)
