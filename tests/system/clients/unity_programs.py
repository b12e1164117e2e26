"""The C# client, compiled as a user of mono compiles it, and its programs for tests, spoken to line by line."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from pcmrs.spatial import Transform
from tests import ROOT

PACKAGE = ROOT / "clients" / "unity"
NEEDS_MONO = pytest.mark.skipif(
    not (shutil.which("mcs") and shutil.which("mono")), reason="mcs and mono are not installed: C# is not compiled here"
)
SWAP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
"""The mirror as a matrix, written here by itself: what the client does is compared with it."""

_COMPILE = ("mcs", "-langversion:7", "-warnaserror")


def compile_client(folder: Path, package: Path = PACKAGE) -> Path:
    """Core without UnityEngine; the components on the stub; the programs. Returns the folder with all of it."""
    core, engine, layer = (folder / f"{name}.dll" for name in ("Pcmrs.Core", "UnityEngine", "Pcmrs.Unity"))
    runtime, tests = package / "Runtime", package / "Tests~"
    _compile(core, sorted((runtime / "Core").glob("*.cs")))
    _compile(engine, [tests / "UnityEngine.cs"])
    _compile(layer, sorted((runtime / "Unity").glob("*.cs")), core, engine)
    _compile(folder / "Probe.exe", [tests / "Probe.cs"], core)
    _compile(folder / "Scene.exe", [tests / "Scene.cs"], core, engine, layer)
    return folder


def _compile(product: Path, sources: list[Path], *references: Path) -> None:
    kind = "library" if product.suffix == ".dll" else "exe"
    words = [
        *_COMPILE,
        f"-target:{kind}",
        f"-out:{product}",
        *(f"-r:{file}" for file in references),
        *map(str, sources),
    ]
    subprocess.run(words, check=True)


class Probe:
    """A running probe: one question at a time."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def ask(self, question: str, *numbers: float) -> dict[str, Any]:
        """The answer to a question and its numbers."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(_line(question, numbers))
        self._process.stdin.flush()
        while not is_answer(line := self._process.stdout.readline()):
            assert line, "the probe has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def numbers(self, question: str, *numbers: float) -> npt.NDArray[np.float64]:
        """The numbers that a question is answered with."""
        return np.array(self.ask(question, *numbers)["numbers"])


@contextmanager
def running_probe(folder: Path, environment: dict[str, str] | None = None) -> Iterator[Probe]:
    """A probe that needs no daemon."""
    with subprocess.Popen(
        ["mono", str(folder / "Probe.exe")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        yield Probe(process)


class CellProbe:
    """A probe that talks to a daemon, while the test goes on."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def ask(self, question: str, *numbers: float) -> dict[str, Any]:
        """The answer to a question and its numbers."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(_line(question, numbers).encode())
        while not is_answer(line := (await self._process.stdout.readline()).decode()):
            assert line, "the probe has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    async def demand(self, question: str, *numbers: float) -> list[float]:
        """The numbers of an answer that is no error."""
        answer = await self.ask(question, *numbers)
        assert "error" not in answer, (question, answer)
        return answer["numbers"] or []

    async def known(self, question: str, within: float = 5.0) -> dict[str, Any]:
        """The answer, asked again until it tells something."""
        async with asyncio.timeout(within):
            while (answer := await self.ask(question)).get("numbers", ...) is None:  # noqa: ASYNC110  # only asking tells
                await asyncio.sleep(0.02)
        return answer

    async def forgotten(self, question: str, within: float) -> None:
        """Asks until nothing is told any more."""
        async with asyncio.timeout(within):
            while (await self.ask(question))["numbers"] is not None:  # noqa: ASYNC110  # only asking tells
                await asyncio.sleep(0.1)


@asynccontextmanager
async def cell_probe(folder: Path, port: int, *signed: str) -> AsyncIterator[CellProbe]:
    """A probe that sends to a command port of a daemon; with a peer's name and key file it signs."""
    words = ["mono", str(folder / "Probe.exe"), str(port), *signed]
    process = await asyncio.create_subprocess_exec(
        *words, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    try:
        yield CellProbe(process)
        assert process.stdin is not None
        process.stdin.close()
        async with asyncio.timeout(5.0):
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


def is_answer(line: str) -> bool:
    """Whether the program wrote this, not mono, which tells here that it does not know how it is scheduled."""
    return line.startswith("{")


def _line(question: str, numbers: tuple[float, ...]) -> str:
    return " ".join([question, *map(repr, map(float, numbers))]) + "\n"


def pose_numbers(pose: Transform) -> list[float]:
    """Position and quaternion x y z w, as programs and wire have them."""
    return [*map(float, pose.translation), *map(float, pose.quat_xyzw)]


def from_numbers(numbers: npt.ArrayLike) -> Transform:
    """The pose that seven numbers mean."""
    values = np.asarray(numbers, dtype=float)
    return Transform.from_quat_xyzw(values[:3], values[3:])


def mirrored(pose: Transform) -> Transform:
    """The same pose in the mirror, by matrices: S T S."""
    return Transform(SWAP @ pose.rotation @ SWAP, SWAP @ pose.translation)


def mirrored_numbers(pose: Transform) -> list[float]:
    """The mirrored pose as a program takes it."""
    return pose_numbers(mirrored(pose))
