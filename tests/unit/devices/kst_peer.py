"""A scripted cabinet: it records what it hears, and its arm is at once where it is told to be."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from pcmrs.kinematics.arms import ARMS

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
