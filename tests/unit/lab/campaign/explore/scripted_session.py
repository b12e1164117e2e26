"""A cell of the deterministic simulation without anything in it: what is asked of it is written down."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from pcmrs.errors import PcmrsError
from pcmrs_lab.campaign.explore.witness import Witness
from pcmrs_sim.deterministic.cell import SimulatedCell
from tests.unit.lab.blueprints import ratms


class ScriptedLink:
    """An endpoint of operators.

    Attributes:
        requests: Keys and commands, in order.
        answers: Of requests, in order; after the last one nobody answers.
        published: Keys.
    """

    def __init__(self) -> None:
        self.requests: list[tuple[str, Any]] = []
        self.answers: list[Any] = []
        self.published: list[str] = []
        self.handlers: dict[str, Callable[[str, Any], None]] = {}

    def subscribe(self, key: str, _kind: type, handler: Callable[[str, Any], None]) -> None:
        self.handlers[key] = handler

    def publish(self, key: str, _message: Any) -> None:
        self.published.append(key)

    async def request(self, key: str, message: Any, _kind: type, _timeout: float) -> Any:
        self.requests.append((key, message))
        answer = self.answers.pop(0) if self.answers else PcmrsError("Nobody answers.")
        if isinstance(answer, Exception):
            raise answer
        return answer

    def send(self, _target: Any, call: Callable[..., None], *arguments: Any) -> None:
        call(*arguments)


class ScriptedDaemon:
    """A daemon whose link takes datagrams.

    Attributes:
        received: Ports and datagrams, in order.
        answers: Called with a datagram: answers to it as verdicts.
        acknowledges: Called with a datagram: acknowledgements of it.
    """

    def __init__(self) -> None:
        self.link = ScriptedLink()
        self.received: list[tuple[int, bytes]] = []
        self.answers: Callable[[bytes], list[str]] = lambda _: []
        self.acknowledges: Callable[[bytes], list[str]] = lambda _: []
        self.verdicts: dict[tuple[str, str], Any] = {}
        self.journal = SimpleNamespace(
            reader=SimpleNamespace(verdict_of=lambda *key: self.verdicts.get(key), read=lambda **_: [])
        )
        self.procedure: Any = None

    def receive(self, port: int, data: bytes, answer: Any, acknowledge: Any) -> None:
        self.received.append((port, data))
        for text in self.answers(data):
            answer(text)
        for text in self.acknowledges(data):
            acknowledge(text)


class ScriptedScene:
    """A scene that takes faults, except those that it refuses."""

    def __init__(self) -> None:
        self.injected: list[tuple[str, dict[str, Any]]] = []
        self.refuses: Exception | None = None

    async def inject(self, name: str, arguments: dict[str, Any]) -> None:
        if self.refuses is not None:
            raise self.refuses
        self.injected.append((name, arguments))


class ScriptedCell:
    """A cell of the simulation.

    Attributes:
        happened: What happened to daemon and node, in order.
        fails: Errors of the next starts of the daemon.
    """

    def __init__(self) -> None:
        self.operator = ScriptedLink()
        self.windows = SimpleNamespace(share=0.0, reached=self._reached)
        self.waited: list[tuple[str, float]] = []
        cut: list[tuple[str, str]] = []
        conditions = SimpleNamespace(loss=0.0, duplicates=0.0, reordering=0.0, delay=0.0, cut=cut)
        conditions.partition = lambda one, other, *, both: cut.append((one, other))
        self.conditions = conditions
        self.network = SimpleNamespace(endpoint=lambda _: self.operator, conditions=conditions, windows=self.windows)
        self.clock = SimpleNamespace(ahead=0.0, frozen=False)
        self.clock.freeze = lambda on: setattr(self.clock, "frozen", on)
        self.disk = SimpleNamespace(delay=0.0, failing=False, landing=False)
        self.scene = ScriptedScene()
        self.devices = {"scene": self.scene}
        self.daemon: ScriptedDaemon | None = ScriptedDaemon()
        self.happened: list[str] = []
        self.fails: list[Exception] = []

    @property
    def as_cell(self) -> SimulatedCell:
        return cast(SimulatedCell, self)

    async def _reached(self, pattern: str, held: float, _timeout: float) -> bool:
        self.waited.append((pattern, held))
        return True

    async def start_daemon(self) -> None:
        self.happened.append("daemon started")
        if self.fails:
            raise self.fails.pop(0)
        self.daemon = ScriptedDaemon()

    async def crash_daemon(self) -> None:
        self.happened.append("daemon crashed")
        self.daemon = None

    async def end_daemon(self) -> None:
        self.happened.append("daemon ended")
        self.daemon = None

    def start_node(self) -> None:
        self.happened.append("node started")

    async def crash_node(self) -> None:
        self.happened.append("node crashed")

    def hold_up(self, process: str, seconds: float) -> None:
        self.happened.append(f"{process} held up {seconds:g} s")


def witness() -> Witness:
    return Witness(ratms())


def now() -> float:
    return asyncio.get_running_loop().time()
