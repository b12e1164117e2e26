"""A daemon, a clock and clients for the gateway's tests."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import aclosing, asynccontextmanager
from typing import Any, Self, cast

import numpy as np
from hypothesis import strategies as st

from pcmrs.dispatcher import DispatcherListener
from pcmrs.gateway._arrival import LOOKS_HZ
from pcmrs.gateway.periodic_timer import kernel_beats
from pcmrs.gateway.rejection_log import PERIOD
from pcmrs.gateway.tracked_poses import TrackedPoses
from pcmrs.messages import BlueprintTag, Command, DeviceEvent, Reason, Snapshot, Verdict
from pcmrs.spatial import Floats, Transform
from pcmrs.workflows.data import PlacementData

POSE = Transform.from_quat_xyzw([0.01, 0.02, 0.03], [0.5, 0.5, 0.5, 0.5])


WITHIN = 10.0
"""A test fails when what it waits for has not come after so long, s."""


CONFIRMED = {
    "measured": {"position": [0.1, 0.2, 0.3], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]},
    "translation_error": 0.00025,
    "rotation_error": 0.001,
}


class FakeCore:
    """Accepts everything except what `refusals` names; an operation with a closed gate waits for it.

    A repeat of (source, id) gets the recorded verdict; `commands` holds what ran, `ages` when each was said to have
    arrived. `after_accepting` is called between the end of an operation and the answer to it.
    """

    def __init__(self) -> None:
        self.branches = {
            "registration": "000", "digitization": "0", "toolplan": "0", "robot": "1", "placement": "retracted",
        }  # fmt: skip
        self.commands: list[Command] = []
        self.ages: list[float | None] = []
        self.arrived = asyncio.Event()
        self.refusals: dict[str, str] = {}
        self.results: dict[str, dict[str, Any]] = {}
        self.gates: dict[str, asyncio.Event] = defaultdict(_open_gate)
        self.stops: list[str] = []
        self.after_accepting: Callable[[], object] = lambda: None
        self.initial_joints: list[float] | None = None
        self.stands = True
        self.events: list[DeviceEvent] = []
        self.listeners: list[DispatcherListener] = []
        self._verdicts: dict[tuple[str, str], Verdict] = {}
        self.pose: Transform | None = POSE
        self.target: Transform | None = POSE
        self.registered: Transform | None = None
        self.placement_data = PlacementData()
        self.tip: Floats | None = np.array([0.1, 0.2, 0.3])

    @property
    def operations(self) -> list[str]:
        return [command.operation for command in self.commands]

    async def submit(self, command: Command, *, arrived: float | None = None) -> Verdict:
        self.ages.append(arrived)
        key = (command.source, command.id)
        if key in self._verdicts:
            return self._verdicts[key]
        self.commands.append(command)
        self.arrived.set()
        await self.gates[command.operation].wait()
        code = self.refusals.get(command.operation)
        self._verdicts[key] = Verdict(
            id=command.id,
            branch=command.branch,
            operation=command.operation,
            decision="rejected" if code else "accepted",
            state=self.branches[command.branch],
            sequence=1,
            reason=Reason(code=code, text="") if code else None,
            result=self.results.get(command.operation),
        )
        if not code:
            for listener in self.listeners:
                listener.on_accepted(command)
            self.after_accepting()
        return self._verdicts[key]

    async def stop(self, source: str) -> bool:
        self.stops.append(source)
        for listener in self.listeners:
            listener.on_stop()
        return self.stands

    def report(self, event: DeviceEvent) -> None:
        self.events.append(event)

    def add_listener(self, listener: DispatcherListener) -> None:
        self.listeners.append(listener)

    def publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        for listener in self.listeners:
            listener.on_publish(message)

    def open_gates(self) -> None:
        """Lets everything that waits end, as the daemon does before the gateway closes."""
        for gate in self.gates.values():
            gate.set()

    def snapshot(self) -> Snapshot:
        return Snapshot(
            sequence=1,
            branches=self.branches,
            flags={},
            running=[],
            latched=False,
            blueprint=BlueprintTag(id="t", version="1", hash=""),
        )

    def joints(self) -> list[float] | None:
        return [0.1 * index for index in range(7)]

    async def remember_initial_joints(self) -> list[float] | None:
        return self.initial_joints

    def flange_pose(self) -> Transform | None:
        return self.pose

    def tool_in_image(self) -> Transform | None:
        return self.pose

    def target_in_image(self) -> Transform | None:
        return self.target

    def tip_in_image(self) -> Floats | None:
        return self.tip

    def registration(self) -> Transform | None:
        return self.registered

    def data(self) -> PlacementData:
        return self.placement_data

    def seen(self) -> dict[str, Transform]:
        return {"coil": POSE, "body_ref": POSE}

    def tracked(self) -> TrackedPoses | None:
        return TrackedPoses(POSE, POSE, POSE)


def _open_gate() -> asyncio.Event:
    gate = asyncio.Event()
    gate.set()
    return gate


class ManualClock:
    """Sleeping advances it, but for waits between two reports; its timeouts pass when the test says so."""

    def __init__(self) -> None:
        self.now = 100.0
        self._timeouts: list[tuple[float, asyncio.Timeout]] = []

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return 1.7e9 + self.now

    async def sleep(self, seconds: float) -> None:
        if seconds >= PERIOD:
            await asyncio.Event().wait()
        self.now += max(0.0, seconds)
        await asyncio.sleep(0)

    @asynccontextmanager
    async def timeout(self, seconds: float) -> AsyncIterator[None]:
        async with asyncio.timeout(None) as timeout:
            entry = (seconds, timeout)
            self._timeouts.append(entry)
            try:
                yield
            finally:
                self._timeouts.remove(entry)

    def expire(self, within: float) -> None:
        """Lets the timeouts that run now pass, those of at most so many seconds."""
        for timeout in (timeout for seconds, timeout in self._timeouts if seconds <= within):
            timeout.reschedule(0.0)


async def pass_look() -> None:
    """Returns once the gateway has looked for empty sockets: what comes from now on is as new as its clock says."""
    async with aclosing(kernel_beats(1.0 / LOOKS_HZ)) as beats:
        for _ in range(4):
            await anext(beats)


async def rest_of(reader: asyncio.StreamReader) -> bytes:
    """Return what comes until the peer ends the connection."""
    async with asyncio.timeout(WITHIN):
        return await reader.read()


class Received(asyncio.Queue[str]):
    """Datagrams that have come; `get` fails when none comes."""

    async def get(self) -> str:
        async with asyncio.timeout(WITHIN):
            return await super().get()


class UdpClient(asyncio.DatagramProtocol):
    """A socket that keeps what it receives."""

    def __init__(self) -> None:
        self.received = Received()

    @classmethod
    async def open(cls) -> Self:
        _, client = await asyncio.get_running_loop().create_datagram_endpoint(cls, local_addr=("127.0.0.1", 0))
        return client

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self.received.put_nowait(data.decode())

    @property
    def port(self) -> int:
        return int(self.transport.get_extra_info("sockname")[1])

    def send(self, data: bytes | str, address: tuple[str, int]) -> None:
        self.transport.sendto(data.encode() if isinstance(data, str) else data, address)

    async def ask(self, data: str, address: tuple[str, int]) -> str:
        """Sends, and returns the next datagram that comes."""
        self.send(data, address)
        return await self.received.get()


ROTVECS = st.tuples(*[st.floats(-1.5, 1.5)] * 3)


POINTS = st.tuples(*[st.floats(-1.0, 1.0)] * 3)
