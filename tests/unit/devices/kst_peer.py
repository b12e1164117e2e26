"""A scripted cabinet: it records what it hears, and its arm is at once where it is told to be."""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from pcmrs.clock import SystemClock
from pcmrs.devices.kst.connection import KstConnection
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats

HOME = [float(q) for q in ARMS["iiwa14"].home]

Answer = Callable[[str], str | None]


def line(values: list[float]) -> str:
    """Numbers as the cabinet ends them."""
    return "_".join(f"{value:.9f}" for value in values) + "_\n"


class Peer:
    """Answers as a KST server with an ideal arm; `answer` replaces an answer, None is silence.

    Attributes:
        heard: Lines, and when.
        joints: Where the arm is.
        offset: Of the joints that it tells, rad.
        torques: External ones, N m.
        servo: Whether a stream runs.
    """

    def __init__(self) -> None:
        self.heard: list[tuple[str, float]] = []
        self.joints = list(HOME)
        self.offset = 0.0
        self.torques = [0.0] * 7
        self.servo = False
        self.answers: dict[str, str | None] = {}
        self.clients = 0
        self._writers: list[asyncio.StreamWriter] = []

    @property
    def lines(self) -> list[str]:
        return [line for line, _ in self.heard]

    def set_points(self) -> list[tuple[list[float], float]]:
        """All set points that came, and when."""
        streamed = ("jf_", "jpJP_", "jpExT_")
        return [
            ([float(word) for word in line.split("_")[1:8]], at) for line, at in self.heard if line.startswith(streamed)
        ]

    def say(self, text: str) -> None:
        """Sends something unasked."""
        self._writers[-1].write(text.encode())

    def close(self) -> None:
        """Closes all connections."""
        for writer in self._writers:
            writer.transport.abort()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.clients += 1
        self._writers.append(writer)
        while data := await reader.readline():
            text = data.decode()
            assert text.endswith("\n")
            self.heard.append((text[:-1], time.monotonic()))
            answer = self._answer(text[:-1])
            if answer:
                writer.write(answer.encode())
        writer.close()

    def _answer(self, command: str) -> str | None:
        name = command.partition("_")[0]
        for start in (command, name):
            if start in self.answers:
                return self.answers[start]
        if name in ("jf", "jpJP", "jpExT"):
            self.joints = [float(word) for word in command.split("_")[1:8]]
        told = line([q + self.offset for q in self.joints])
        torques = line(self.torques)
        answers = {"jf": None, "jpJP": told, "getJointsPositions": told, "jpExT": torques, "end": None}
        if command.startswith("Torques"):
            return torques
        return answers.get(name, "done\n")


@asynccontextmanager
async def served(peer: Peer) -> AsyncIterator[tuple[str, int]]:
    """Serves a peer on a port of its own."""
    server = await asyncio.start_server(peer.serve, "127.0.0.1", 0)
    host, port = server.sockets[0].getsockname()[:2]
    try:
        yield host, port
    finally:
        server.close()
        peer.close()
        await asyncio.sleep(0.01)  # the connections see their end


Q = [0.1, -0.2, 0.3, -1.5, 1e-7, 1.23456789, -3.0]

Q_WIRE = b"0.10000_-0.20000_0.30000_-1.50000_0.00000_1.23457_-3.00000_"

DONE = b"done\n"

SEVEN = b"0.1_-0.2_1.0E-4_-1.5_0.0_2.5E7_-3.0_\n"

SEVEN_VALUES = [0.1, -0.2, 1e-4, -1.5, 0.0, 2.5e7, -3.0]

Step = Callable[[KstConnection], Awaitable[Any]]


async def conversation(
    step: Step, script: list[tuple[bytes, bytes]], chunk: int | None = None, timeout: float = 0.5
) -> tuple[Any, bytes]:
    """What the client makes of answers that come `chunk` bytes at a time, and all that it sent."""
    heard = bytearray()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for request, answer in script:
            heard.extend(await reader.readexactly(len(request)))
            for start in range(0, len(answer), chunk or len(answer)):
                writer.write(answer[start : start + (chunk or len(answer))])
                await writer.drain()
                await asyncio.sleep(0)
        heard.extend(await reader.read())
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    host, port = server.sockets[0].getsockname()[:2]
    cabinet = await KstConnection.open(host, port, SystemClock(), 1.0, timeout)
    try:
        result = await step(cabinet)
    finally:
        cabinet.end()
        await asyncio.sleep(0.02)  # the server reads the end
        server.close()
    return result, bytes(heard)


MODEL = ArmModel(ARMS["iiwa14"])

START = np.array(HOME)


def torques_of(force_in_flange: Floats, posture: Floats = START) -> Floats:
    """What the joints feel of a force on the flange."""
    force = MODEL.forward(posture).rotation @ force_in_flange
    torques: Floats = MODEL.jacobian(posture).T @ np.concatenate((force, np.zeros(3)))
    return torques
