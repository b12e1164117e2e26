"""A child that is started as a new Python has the session, the streams and the descriptors that it was given."""

from __future__ import annotations

import asyncio
import os
import sys
from asyncio.subprocess import DEVNULL, PIPE
from pathlib import Path

import pytest

from pcmrs.processes.starting import start_by_exec
from tests import ROOT

WITHIN = 60.0
CHILD = """
import os, sys

print(sys.argv[1:], os.getsid(0) == os.getpid(), flush=True)
if len(sys.argv) > 2:
    os.write(int(sys.argv[2]), b"passed")
sys.exit(len(sys.stdin.read()))
"""


@pytest.fixture(autouse=True)
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a module `child`, which a new Python finds."""
    (tmp_path / "child.py").write_text(CHILD)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), str(ROOT))))


async def test_a_child_has_its_words_and_its_own_session() -> None:
    async with asyncio.timeout(WITHIN):
        process = await start_by_exec("child", "a b", stdout=PIPE)
        assert process.stdout is not None
        assert await process.stdout.readline() == b"['a b'] True\n", "a Ctrl-C at the terminal is not for it"
        assert process.stdin is not None
        process.stdin.write(b"1234567")
        process.stdin.close()
        assert await process.wait() == 7


async def test_a_passed_descriptor_keeps_its_number() -> None:
    reading, writing = os.pipe()
    async with asyncio.timeout(WITHIN):
        process = await start_by_exec("child", "it", str(writing), stdin=DEVNULL, stdout=DEVNULL, passed=writing)
        os.close(writing)
        assert await process.wait() == 0
    assert os.read(reading, 100) == b"passed"
    os.close(reading)


async def test_no_other_descriptor_reaches_the_child() -> None:
    reading, writing = os.pipe()
    os.set_inheritable(writing, True)
    async with asyncio.timeout(WITHIN):
        process = await start_by_exec("child", "it", str(writing), stdin=DEVNULL, stdout=DEVNULL)
        os.close(writing)
        assert await process.wait() == 1, "writing to it fails"
    assert os.read(reading, 100) == b""
    os.close(reading)


async def test_a_python_that_is_not_there_cannot_be_started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    with pytest.raises(OSError, match="python"):
        await start_by_exec("child")
