"""Replays a trace of the model of Stop on the daemon's side: dispatcher, remote arm, node with its gate, and journal.

All of these are the product's own. The trace decides in which order frames arrive, when their answers do, when the rows
of a motion are on the disk, and when one of the two processes is killed. The hold that ends a failed motion is not in
the model: it arrives at once, or right behind the hold of the Stop that has ended the motion.
"""

from __future__ import annotations

import asyncio
import copy
from collections.abc import AsyncIterator, Coroutine, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import msgspec

from pcmrs.devices.gate import RELEASE
from pcmrs.devices.node import DeviceNode
from pcmrs.devices.remote import RemoteRobot
from pcmrs.dispatcher import Dispatcher, Registry, Run, Workflow
from pcmrs.dispatcher.stops import STANDSTILL
from pcmrs.errors import RefusalError, UnknownOutcomeError
from pcmrs.fsm import load_blueprint
from pcmrs.journal import Journal, JournalRow
from pcmrs.messages import (
    BlueprintTag,
    Command,
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    JointState,
    JointTrajectory,
    MotionResult,
)
from pcmrs.service.procedure import Clocks, open_cell
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.service.supervisor import Supervisor
from pcmrs.service.watches.gates import GateWatch
from pcmrs.settings import Settings
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows._connection import connect_robot
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from tests.support.memory_link import MemoryLink

BLUEPRINT = load_blueprint(Path(__file__).with_name("stop.toml"))
EVENT = "reference_moved"
NEVER_SILENT = 1e9
AT_REST = JointState(captured=1.0, sent=1.0, positions=[0.0] * 7, velocities=[0.0] * 7, torques=[0.0] * 7)
WAY = JointTrajectory(period=0.01, positions=[[0.0] * 7, [0.1] * 7])

M = TypeVar("M", bound=msgspec.Struct)


class DifferenceError(Exception):
    """The code does something else than the model."""


class TracedJournal(Journal):
    """A journal in which some rows reach the disk only when the trace says so."""

    late: dict[str, list[tuple[Sequence[JournalRow], asyncio.Future[int]]]]
    over = False

    @classmethod
    def at(cls, path: Path) -> TracedJournal:
        journal = cast(TracedJournal, cls.open(path, durable=False))
        journal.late = {}
        return journal

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        if self.over:
            durable.cancel()
            return durable
        row = rows[-1]
        decided = row.verdict is None or row.verdict.decision == "accepted"
        if not (decided and row.operation in ("move", EVENT) and row.kind in ("intent", "outcome")):
            return super().append(rows)
        self.late.setdefault(f"{row.kind} {row.operation}", []).append((rows, durable))
        return durable

    def write(self, name: str) -> None:
        """The late rows of this name are on the disk."""
        for rows, durable in self.late.pop(name, []):
            durable.set_result(super().append(rows).result())

    def abandon(self) -> None:
        """The daemon is gone: what is not on the disk never will be."""
        self.late.clear()


class Arm:
    """Moves until it is held, or the trace says that it is where it should be."""

    trouble = ""
    dropped = 0

    def __init__(self) -> None:
        self._end: asyncio.Future[MotionResult] | None = None

    @property
    def moving(self) -> bool:
        return self._end is not None and not self._end.done()

    def end(self, reason: str | None = None) -> None:
        """The motion ends: as it should, or for a reason."""
        if self._end is not None and not self._end.done():
            outcome = MotionResult(outcome="done" if reason is None else "stopped", positions=[0.1] * 7, reason=reason)
            self._end.set_result(outcome)

    async def connect(self) -> JointState:
        return AT_REST

    async def joints(self) -> JointState:
        return msgspec.structs.replace(AT_REST, moving=self.moving)

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        self._end = asyncio.get_running_loop().create_future()
        return await self._end

    async def hold(self) -> JointState:
        self.end("held")
        return AT_REST

    async def states(self) -> AsyncIterator[JointState]:
        await asyncio.Event().wait()
        yield AT_REST

    async def events(self) -> AsyncIterator[DeviceEvent]:
        await asyncio.Event().wait()
        yield DeviceEvent(device="robot", code="never", text="")


class Node:
    """One start of the arm's node."""

    def __init__(self) -> None:
        self.arm = Arm()
        self.link = MemoryLink()
        self.node = DeviceNode(self.link, {"robot": self.arm}, ManualClock(), deadman=NEVER_SILENT)
        self.running = asyncio.ensure_future(self.node.run())

    async def answer(self, request: msgspec.Struct) -> DeviceReply:
        return await self.link.request("dev/robot/cmd", request, DeviceReply, 0.0)


@dataclass(eq=False)
class Frame:
    """A request on its way.

    Attributes:
        daemon: Which has sent it.
        heard: What the daemon waits for.
        answer: Of the node, once it has arrived there.
    """

    daemon: int
    request: DeviceRequest
    heard: asyncio.Future[DeviceReply]
    answer: asyncio.Task[DeviceReply] | None = None

    @property
    def method(self) -> str:
        return self.request.method

    @property
    def of_stop(self) -> bool:
        """Whether it is the hold of a Stop."""
        return self.method == "hold" and self.request.latch


class Wire(MemoryLink):
    """A daemon's side of the network: what it asks stays on the way."""

    def __init__(self, daemon: int, frames: list[Frame]) -> None:
        super().__init__()
        self._daemon, self._frames = daemon, frames

    async def request(
        self,
        key: str,
        message: msgspec.Struct,
        reply: type[M],
        timeout: float,
        sender: str = "",
        *,
        urgent: bool = False,
    ) -> M:
        heard: asyncio.Future[DeviceReply] = asyncio.get_running_loop().create_future()
        self._frames.append(Frame(self._daemon, cast(DeviceRequest, message), heard))
        return cast(M, await heard)


async def move(run: Run[Cell, PlacementData]) -> None:
    """The motion of the model."""
    result = await run.cell.robot.follow(WAY)
    if result.outcome != "done":
        raise RefusalError("motion_stopped", f"The arm was stopped: {result.reason}.")


def make_workflow() -> Workflow[Cell, PlacementData]:
    registry: Registry[Cell, PlacementData] = Registry()
    registry.world_step(connect_robot)
    registry.world_step(move, moves=True)
    return Workflow(BLUEPRINT, registry, PlacementData(), lambda data, _states, _effects: data)


WORKFLOW = make_workflow()


def make_cell() -> Cell:
    """A cell whose robot each daemon replaces by its own."""
    settings = msgspec.convert({"stimulator": {"driver": "none"}, "emg": {"driver": "none"}}, Settings)
    return open_cell(settings, BLUEPRINT, MemoryLink(), Clocks(ManualClock(), ManualClock()), "")


class Spawner:
    """A supervisor that lets tasks be."""

    def __init__(self) -> None:
        self._tasks: list[asyncio.Future[None]] = []

    def spawn(self, _name: str, work: Coroutine[Any, Any, None]) -> None:
        self._tasks.append(asyncio.ensure_future(work))


class Daemon:
    """One start of the daemon.

    Args:
        number: Of the start, as the model counts.
        journal: Where it writes, and what it begins with.
        frames: Where its requests go.
        cell: See `make_cell`.
    """

    def __init__(self, number: int, journal: TracedJournal, frames: list[Frame], cell: Cell) -> None:
        clock, session = ManualClock(), f"daemon {number}"
        self.number, self.session = number, session
        robot = RemoteRobot(Wire(number, frames), clock, session)
        mine = copy.copy(cell)
        mine.robot = robot
        tag = BlueprintTag(id=BLUEPRINT.id, version=BLUEPRINT.version, hash=BLUEPRINT.hash)
        self._recorder = JournalRecorder(journal, clock, session, tag)
        self.dispatcher: Dispatcher[Cell, PlacementData] = Dispatcher(
            WORKFLOW, mine, clock, self._recorder, mine.make_safe, release=mine.release
        )
        self.watch = GateWatch([robot], self.dispatcher, lambda: self.connected, cast(Supervisor, Spawner()))
        self._commands = 0

    @property
    def connected(self) -> bool:
        return self.dispatcher.procedure.joint()["robot"] == "1"

    async def start(self) -> None:
        """Begins with what the journal says; somebody registers at once, as the model has it."""
        recorder = self._recorder
        before = recorder.read_back(BLUEPRINT)
        start = await recorder.started({}, "")
        await recorder.close_unfinished(before.begun)
        self.dispatcher.restore(latched=recorder.kept.latched, unknown=recorder.kept.unknown, start=start)
        await self.dispatcher.submit(self.command("registration.register"))

    def command(self, name: str, **arguments: Any) -> Command:
        self._commands += 1
        branch, operation = name.split(".")
        return Command(
            id=f"{self.number}-{self._commands}",
            branch=branch,
            operation=operation,
            source="test:operator",
            arguments=arguments,
        )

    async def allows(self, name: str, **arguments: Any) -> bool:
        return (await self.dispatcher.dry_run(self.command(name, **arguments))).reason is None


class Replay:
    """One trace on the code.

    Args:
        journal: Of its own.
        cell: See `make_cell`.
    """

    def __init__(self, journal: TracedJournal, cell: Cell) -> None:
        self._journal, self._cell = journal, cell
        self._frames: list[Frame] = []
        self._node = Node()
        self._daemon = Daemon(1, journal, self._frames, cell)
        self._commands: list[asyncio.Task[Any]] = []
        self._releases: dict[tuple[int, int], list[Frame]] = {}
        self._holds: dict[int, list[Frame]] = {}
        self._motions: dict[int, Frame] = {}
        self._mover = 0
        self._taken = False

    async def start(self) -> None:
        await self._daemon.start()
        await settle()

    async def end(self) -> None:
        """Nothing is answered any more, and whatever still waits is ended."""
        self._journal.over = True
        while left := asyncio.all_tasks() - {asyncio.current_task()}:
            for task in left:
                task.cancel()
            await settle()
        await self._journal.close()

    async def take(self, line: str) -> None:
        """One line of the trace.

        Raises:
            DifferenceError: The code does not do what the model does.
        """
        kind, _, rest = line.partition(" ")
        if kind == "step":
            name, *numbers = rest.split()
            try:
                await getattr(self, f"_{name}")(*map(int, numbers))
                await self._pass_on(wait=name in ("connect", "acknowledge"))
            except (KeyError, IndexError):
                raise DifferenceError(f"{line}: there is no such frame.") from None
        elif kind == "gate" and "->" in rest:
            self._compare(line, rest.endswith("1"), self._taken)
        elif kind == "state":
            for number, (model, code) in enumerate(zip(rest.split(), await self._state(), strict=True)):
                if code is not None:
                    self._compare(f"{line}: value {number}", int(model), int(code))

    @staticmethod
    def _compare(line: str, model: int, code: int) -> None:
        if model != code:
            raise DifferenceError(f"{line}: the code has {code}.")

    async def _state(self) -> tuple[int | None, ...]:
        """Connected, latched, what is pending, registered, at the body, the motion that moves, what is allowed."""
        dispatcher, shown = self._daemon.dispatcher, self._daemon.dispatcher.snapshot()
        acknowledge = await self._daemon.allows("robot.acknowledge", stop=dispatcher.stop_number)
        return (
            self._daemon.connected,
            shown.latched,
            STANDSTILL in shown.stop.pending,
            f"registration.{EVENT}" in shown.stop.pending,
            shown.branches["registration"] == "1",
            shown.branches["placement"] == "placed" if not shown.running else None,  # until its outcome is on the disk
            self._mover if self._node.arm.moving else 0,
            await self._daemon.allows("placement.move"),
            shown.latched and acknowledge,
        )

    # -- frames -----------------------------------------------------------------------------------------

    async def _pass_on(self, *, wait: bool = False) -> None:
        """Frames that the model does not have arrive at once, and are answered.

        Args:
            wait: The hold before a release is one that the model has.
        """
        await settle()
        while passing := [frame for frame in self._frames if self._passes(frame, wait=wait)]:
            for frame in passing:
                await self._deliver(frame)
                await self._hear(frame)
        if self._daemon.dispatcher.snapshot().branches["placement"] == "held":
            self._submit("placement.locate")  # somebody looks at once
            await settle()

    def _passes(self, frame: Frame, *, wait: bool) -> bool:
        if frame.answer is not None or frame.daemon != self._daemon.number:
            return False
        if frame.method in ("connect", "joints"):
            return True
        ends_motion = frame.method == "hold" and not frame.of_stop and not wait and not self._is_release(frame)
        return ends_motion and not any(each.of_stop for each in self._on_the_way(frame.daemon))

    def _is_release(self, frame: Frame) -> bool:
        return any(frame in frames for frames in self._releases.values())

    def _on_the_way(self, daemon: int) -> list[Frame]:
        return [frame for frame in self._frames if frame.daemon == daemon and frame.answer is None]

    async def _deliver(self, frame: Frame) -> None:
        frame.answer = asyncio.ensure_future(self._node.answer(frame.request))
        await settle()

    async def _hear(self, frame: Frame) -> None:
        """The answer reaches the daemon, if it still runs; a node that was restarted gives none."""
        if frame.daemon == self._daemon.number and not frame.heard.done() and frame.answer is not None:
            if frame.answer.done() and not frame.answer.cancelled():
                frame.heard.set_result(frame.answer.result())
            else:
                frame.heard.set_exception(UnknownOutcomeError("The node has ended before it answered."))
        await settle()

    # -- steps of the model -----------------------------------------------------------------------------

    def _submit(self, name: str, **arguments: Any) -> None:
        command = self._daemon.command(name, **arguments)
        self._commands.append(asyncio.ensure_future(self._daemon.dispatcher.submit(command)))

    async def _begin_release(self, daemon: int, which: int) -> None:
        """Of a connection or an acknowledgement: the hold before its release is on its way, if it has one."""
        await self._pass_on(wait=True)
        held = [frame for frame in self._on_the_way(daemon) if frame.method == "hold" and not frame.of_stop]
        self._releases[daemon, which] = [frame for frame in held if not self._is_release(frame)]

    async def _connect(self, daemon: int, which: int) -> None:
        self._submit("robot.connect")
        await self._begin_release(daemon, which)

    async def _acknowledge(self, daemon: int, which: int) -> None:
        self._submit("robot.acknowledge", stop=self._daemon.dispatcher.stop_number)
        await self._begin_release(daemon, which)

    async def _end(self, daemon: int, which: int) -> None:
        await self._deliver(self._releases[daemon, which][0])

    async def _ended(self, daemon: int, which: int) -> None:
        await self._hear(self._releases[daemon, which][0])
        released = [frame for frame in self._on_the_way(daemon) if frame.method == RELEASE]
        self._releases[daemon, which].append(released[-1])

    async def _release(self, daemon: int, which: int) -> None:
        frame = self._releases[daemon, which][1]
        await self._deliver(frame)
        assert frame.answer is not None
        self._taken = frame.answer.result().failure is None

    async def _released(self, daemon: int, which: int) -> None:
        await self._hear(self._releases[daemon, which][1])

    async def _motion(self, _motion: int) -> None:
        self._submit("placement.move")

    async def _request(self, motion: int) -> None:
        self._journal.write("intent move")
        await settle()
        asked = [frame for frame in self._on_the_way(self._daemon.number) if frame.method == "follow"]
        self._motions[motion] = asked[-1]

    async def _arrive(self, motion: int) -> None:
        frame = self._motions[motion]
        await self._deliver(frame)
        assert frame.answer is not None
        self._taken = not frame.answer.done()
        self._mover = motion if self._taken else self._mover

    async def _done(self, motion: int) -> None:
        self._node.arm.end()
        await settle()
        await self._hear(self._motions[motion])

    async def _failed(self, motion: int) -> None:
        await self._hear(self._motions[motion])

    async def _committed(self, _motion: int) -> None:
        self._journal.write("outcome move")

    async def _stop(self) -> None:
        self._daemon.dispatcher.begin_stop("test:operator")
        await self._let_stopped_end()

    async def _event(self) -> None:
        event = DeviceEvent(device="reference", code=EVENT, text="It has slipped.", danger=True)
        self._daemon.dispatcher.report_later(event)
        await self._let_stopped_end()

    async def _beat(self) -> None:
        reply = await self._node.answer(DeviceRequest(method="joints", arguments={}))
        assert reply.gate is not None
        of_an_earlier_daemon = reply.gate.daemon not in ("", self._daemon.session)
        self._daemon.watch.take("robot", reply.gate)
        await self._let_stopped_end()
        if of_an_earlier_daemon:  # the hold with which a daemon takes a device over is not in the model: it is lost
            lost = [frame for frame in self._on_the_way(self._daemon.number) if frame.of_stop]
            self._frames[:] = [frame for frame in self._frames if frame not in lost]

    async def _let_stopped_end(self) -> None:
        """The intent of a motion that was stopped before it was on the disk."""
        await settle()
        if self._daemon.dispatcher.snapshot().latched:
            self._journal.write("intent move")

    async def _decided(self) -> None:
        self._journal.write(f"outcome {EVENT}")

    async def _hold(self, daemon: int) -> None:
        """With what is behind it in the queue of its sender."""
        way = [frame for frame in self._on_the_way(daemon) if frame.method == "hold" and not self._is_release(frame)]
        of_stop = [frame for frame in way if frame.of_stop]
        self._holds[daemon] = way[way.index(of_stop[0]) :]
        for frame in self._holds[daemon]:
            await self._deliver(frame)

    async def _held(self, daemon: int) -> None:
        for frame in self._holds.pop(daemon):
            await self._hear(frame)

    async def _deadman(self) -> None:
        await self._node.node.make_safe("nothing is heard of the daemon")

    async def _restart(self) -> None:
        self._node.running.cancel()
        for frame in self._frames:
            if frame.answer is not None and not frame.answer.done():
                frame.answer.cancel()
        self._node = Node()

    async def _crash(self) -> None:
        self._journal.abandon()
        self._daemon = Daemon(self._daemon.number + 1, self._journal, self._frames, self._cell)
        await self._daemon.start()


async def first_difference(trace: str, path: Path, cell: Cell) -> str | None:
    """Replays a trace; returns where the code first does something else than the model.

    Args:
        trace: What SPIN has printed.
        path: Of a journal of its own.
        cell: See `make_cell`.
    """
    replay = Replay(TracedJournal.at(path), cell)
    await replay.start()
    try:
        for line in trace.splitlines():
            await replay.take(line.strip())
    except DifferenceError as difference:
        return str(difference)
    finally:
        await replay.end()
    return None
