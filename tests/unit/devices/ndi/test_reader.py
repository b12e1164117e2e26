"""The reader process: what it reports of its tracker, and when it ends."""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import PIPE

import pytest

from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.process import MODULE
from pcmrs.devices.ndi.reader import without_sign_extension
from pcmrs.devices.ndi.tools import placeholder
from pcmrs.devices.ndi.wire import Failed, ReaderJob, TrackerReady, Unpacker, pack
from pcmrs_sim.cell import running_cell
from pcmrs_sim.ndi.server import serve_ndi_pty
from pcmrs_sim.ndi.system import NdiSystem
from tests.unit.devices.ndi_reader import DEADLINE, frames_of, ndi_tracker, served_ndi, true_marker


async def test_a_tracker_without_bx_is_asked_in_text(monkeypatch: pytest.MonkeyPatch) -> None:
    perform = NdiSystem.answer
    monkeypatch.setattr(NdiSystem, "answer", lambda self, line: perform(self, line.replace(b"BX", b"QX")))
    async with served_ndi() as (cell, device), ndi_tracker(device=device) as tracker:
        frames = await frames_of(tracker, 5)
    coil = next(pose for pose in frames[-1] if pose.body == "coil")
    truth = true_marker(cell).translation
    assert coil.valid
    assert list(coil.position) == pytest.approx(truth.tolist(), abs=1e-3)
    assert all(round(1e5 * value, 6).is_integer() for value in coil.position), "text has hundredths of a millimetre"


async def test_the_reader_ends_with_its_parent() -> None:
    async with asyncio.timeout(DEADLINE), served_ndi() as (_, device):
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        assert reader.stdin is not None
        assert reader.stdout is not None
        reader.stdin.write(pack(ReaderJob(device, 115200, {"coil": placeholder("coil")})))
        assert await reader.stdout.readexactly(4)
        reader.stdin.close()
        assert await reader.stdout.read()
        assert await reader.wait() == 0


async def test_serial_reader_finds_its_tracker_and_ends_with_its_input() -> None:
    async with asyncio.timeout(DEADLINE), running_cell({}, SystemClock()) as cell, serve_ndi_pty(cell) as device:
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        reported, _ = await reader.communicate(pack(ReaderJob(device, 115200, {"coil": placeholder("coil")})))
    assert isinstance(Unpacker().feed(reported)[0], TrackerReady)
    assert reader.returncode == 0


async def test_reader_reports_a_serial_port_that_cannot_be_opened() -> None:
    async with asyncio.timeout(DEADLINE):
        reader = await asyncio.create_subprocess_exec(sys.executable, "-m", MODULE, stdin=PIPE, stdout=PIPE)
        reported, _ = await reader.communicate(pack(ReaderJob("/dev/pts/none", 115200, {"coil": placeholder("coil")})))
    assert Unpacker().feed(reported) == [Failed("this cannot be opened as a serial port")]
    assert reader.returncode == 0


@pytest.mark.parametrize(
    ("word", "known"),
    [(0x31, 0x31), (0x8031, 0x8031), (0xFFFFFFFFFFFFFFB1, 0xB1), (0xFFFFFFFFFFFF8131, 0x8131), (2**32 - 1, 2**32 - 1)],
)
def test_a_status_word_is_freed_from_the_signs_of_its_bytes(word: int, known: int) -> None:
    assert without_sign_extension(word) == known
