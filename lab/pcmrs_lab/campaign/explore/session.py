"""Runs one script: a cell in simulated time, its operators, its faults, and a witness of all events."""

from __future__ import annotations

import asyncio
import logging
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import process_time
from typing import Any, NoReturn

import msgspec
import structlog

from pcmrs.journal import JournalReader
from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.testing.detector import ScriptedDetector
from pcmrs_lab.campaign.explore.injecting import Faults
from pcmrs_lab.campaign.explore.next_step_policy import next_step_policy
from pcmrs_lab.campaign.explore.operators import PATIENCE, Operators
from pcmrs_lab.campaign.explore.plans import GARBAGE, landmark_commands, plan_of, pose_commands
from pcmrs_lab.campaign.explore.script import Act, SessionScript
from pcmrs_lab.campaign.explore.settings import FRAME_RATE, settings_of, workflow_of
from pcmrs_lab.campaign.explore.witness import InvariantViolation, Witness
from pcmrs_sim.deterministic.cell import SimulatedCell, simulated_cell
from pcmrs_sim.deterministic.entropy import seeded_entropy

QUIET_END = 10.0
"""Pause after the last act without faults, s: longer than a watcher's limits."""
LONGEST_MOTION = 60
"""Further time within which every operation has ended, s: a retreat of 0.6 m takes 10 s."""
WINDOW_OPENS = 8.0
"""Time after which an act that waits for a window is done anyway, s: longer than any motion takes."""
REFERENCE = "body_ref"
"""Body that no session removes permanently."""
LONGEST_FOLLOWING = 3.0
"""Longest pause between acts while the tool follows the head, s, since each second has 60 set points."""


class ExplorationResult(msgspec.Struct, frozen=True):
    """Result of a session.

    Attributes:
        seed: Seed of the script.
        time: Simulated time, s.
        cost: Processor time, s.
        digest: Hash of the last row of its journal, which covers all earlier rows; hexadecimal.
        rows: Rows of the journal.
        reached: Number of times that each fault was injected.
        seen: Number of times that each decision on each operation was seen.
        invariant: Name of the violated invariant; empty if all held.
        text: Description of the violation.
        at: Time of the violation, s.
    """

    seed: int
    time: float
    cost: float
    digest: str
    rows: int
    reached: dict[str, int]
    seen: dict[str, int]
    invariant: str = ""
    text: str = ""
    at: float = 0.0


def run_session(script: SessionScript, *, seconds: float = 0.0) -> ExplorationResult:
    """Run a script to its end, or to the first violation.

    The process must do nothing else meanwhile, since the randomness of the operating system is replaced.

    Args:
        script: Script of the session.
        seconds: Pause at the end in which nothing happens, s, to measure its cost.

    Returns:
        Result.

    Raises:
        ConfigurationError: The workflow is unknown.
        SimulationError: The simulation itself could not continue.
    """
    started = process_time()
    with (
        tempfile.TemporaryDirectory(prefix="pcmrs-explore-", dir=_memory()) as folder,
        seeded_entropy(script.seed),
        quiet(),
    ):
        path = Path(folder) / "journal.sqlite"
        loop = SimulatedLoop()
        try:
            session = loop.run_until_complete(_run_script(script, path, seconds))
        finally:
            loop.close()
        digest, rows = _digest(path)
    violation = session.witness.violation
    return ExplorationResult(
        seed=script.seed,
        time=loop.time(),
        cost=process_time() - started,
        digest=digest,
        rows=rows,
        reached=dict(session.faults.reached),
        seen=dict(session.witness.view.seen),
        invariant=violation.invariant if violation else "",
        text=violation.text if violation else "",
        at=violation.time if violation else 0.0,
    )


async def _run_script(script: SessionScript, path: Path, seconds: float) -> ExploredSession:
    workflow = workflow_of(script.workflow)
    witness = Witness(workflow.blueprint)
    asyncio.get_running_loop().set_exception_handler(lambda _, context: _unhandled(witness, context))
    async with simulated_cell(
        settings_of(script.workflow, script.physics, script.seed, scene=script.scene),
        workflow,
        path,
        script.seed,
        coded=script.coded,
        watched=witness.watched,
        observe=witness.observe,
    ) as cell:
        cell.network.windows.share = script.slow
        cell.network.windows.on_open = witness.window_opened
        cell.network.on_request = witness.request_arrived
        session = ExploredSession(cell, witness, script)
        with witness.watching(cell.devices["scene"]):
            await session.faults.start_daemon()
            await session.run(seconds)
    return session


class ExploredSession:
    """Running session.

    Attributes:
        witness: Witness of all events.
        faults: Faults that are present.
    """

    def __init__(self, cell: SimulatedCell, witness: Witness, script: SessionScript) -> None:
        self.witness = witness
        self._cell = cell
        self._script = script
        self._operators = Operators(cell, witness.answered, witness.watcher)
        self._detector = _detector(cell) if script.scene else None
        self.faults = Faults(cell, self._operators, witness, self._detector)
        self._running_acts: dict[asyncio.Task[None], str] = {}

    async def run(self, seconds: float) -> None:
        """Perform all acts in their order, and end with the first violation."""
        loop = asyncio.get_running_loop()
        violated = loop.create_task(self.witness.violated.wait())
        acting = loop.create_task(self._act_all(seconds))
        watching = [] if self._detector is None else [loop.create_task(self._detector.run())]
        await asyncio.wait([violated, acting], return_when=asyncio.FIRST_COMPLETED)
        for task in (violated, acting, *watching, *self._running_acts):
            task.cancel()
        await asyncio.gather(violated, *watching, *self._running_acts, return_exceptions=True)
        if acting.done() and not acting.cancelled():
            acting.result()
        await asyncio.gather(acting, return_exceptions=True)

    async def _act_all(self, seconds: float) -> None:
        for act in self._script.acts:
            if act.window:
                await self._cell.network.windows.reached(act.window, act.held, WINDOW_OPENS)
            await asyncio.sleep(min(act.after, LONGEST_FOLLOWING) if self._following() else act.after)
            task = asyncio.get_running_loop().create_task(self._do(act))
            self._running_acts[task] = act.what
            task.add_done_callback(self._running_acts.pop)
            if act.waits:
                await asyncio.wait([task], timeout=PATIENCE)
        if started := [task for task, what in self._running_acts.items() if what.startswith("fault:")]:
            await asyncio.wait(started, timeout=PATIENCE)  # a fault that is not injected yet cannot be ended
        await self.faults.wait_until_over()
        await self.faults.start_daemon()
        await asyncio.sleep(seconds)
        await self._settle()

    def _following(self) -> bool:
        snapshot = self.witness.view.snapshot
        return snapshot is not None and snapshot.branches.get("placement") == "following"

    def _is_running(self) -> bool:
        snapshot = self.witness.view.snapshot
        return snapshot is not None and bool(snapshot.running)

    async def _settle(self) -> None:
        """Wait until every operation ends, now that no fault is present."""
        if self._running_acts:
            await asyncio.wait(tuple(self._running_acts), timeout=2 * PATIENCE)
        if self.faults.mistaken:
            await self.faults.inject("tracker_restart", {})
        await asyncio.sleep(QUIET_END)
        for _ in range(LONGEST_MOTION):
            if not self._is_running():
                break
            await asyncio.sleep(1.0)
        snapshot, daemon = self.witness.view.snapshot, self._cell.daemon
        if daemon is not None and daemon.procedure is not None:
            self.witness.watcher.poses_end(daemon.procedure.cell.poses.rate_hz(REFERENCE) > 0.0)
        if snapshot is not None and snapshot.running:
            names = ", ".join(f"{each.branch}.{each.operation}" for each in snapshot.running)
            self.witness.break_("everything_ends", f"{names} is still running after all faults have ended.")

    async def _do(self, act: Act) -> None:
        name, operators, who = act.what, self._operators, act.who
        if name.startswith("fault:"):
            await self.faults.inject(name.removeprefix("fault:"), act.arguments)
        elif name == "go_on":
            turn = int(act.arguments.get("turn", 0))
            what, arguments = next_step_policy(operators.snapshot, turn)
            await self._step(who, what, arguments, turn)
        elif name == "stop":
            operators.stop(who)
        elif name == "repeat":
            await operators.repeat(who)
        elif name.startswith("reuse:"):
            await operators.reuse(who, name.removeprefix("reuse:"), act.arguments)
        elif name.startswith("old:"):
            operators.old_client(name.removeprefix("old:"), tuple(act.arguments.get("tokens", ())))
        elif name == "datagram":
            operators.datagram(who, GARBAGE[int(act.arguments["number"]) % len(GARBAGE)])
        else:
            await self._step(who, name, act.arguments, 0)

    async def _step(self, who: str, what: str, arguments: dict[str, Any], turn: int) -> None:
        operators, workflow = self._operators, self._script.workflow
        if what in ("landmarks", "pose"):
            commands = landmark_commands(workflow) if what == "landmarks" else pose_commands(workflow, turn)
            for name, tokens in commands:
                await operators.wire(who, name, tokens)
        elif what.startswith("wire:"):
            await operators.wire(who, what.removeprefix("wire:"), tuple(arguments.get("tokens", ())))
        else:
            payload = {"registration.plan_landmarks": "landmarks", "toolplan.plan": "tool_pose"}.get(what)
            if payload is not None and not arguments:
                arguments = self._planned(payload, turn)
            elif what == "robot.acknowledge" and not arguments and operators.snapshot is not None:
                arguments = {"stop": operators.snapshot.stop.number}
            await operators.operate(who, what, arguments)

    def _planned(self, payload: str, turn: int) -> dict[str, Any]:
        poses = plan_of(self._script.workflow).poses
        if payload == "tool_pose":
            return dict(msgspec.to_builtins(poses[turn % len(poses)]))
        landmarks = plan_of(self._script.workflow).landmarks
        return {"landmarks": msgspec.to_builtins(landmarks)}


def _detector(cell: SimulatedCell) -> ScriptedDetector:
    link, clock = cell.network.endpoint("detector"), SimulatedClock(asyncio.get_running_loop())
    return ScriptedDetector(link.publish, clock, rate_hz=FRAME_RATE)


def _unhandled(witness: Witness, context: dict[str, Any]) -> None:
    error = context.get("exception")
    witness.break_("no_error_is_lost", f"{context.get('message')}: {type(error).__name__} {error}")


def _digest(path: Path) -> tuple[str, int]:
    with JournalReader(path) as journal:
        last = next(iter(journal.read(last=1)), None)
    return ("", 0) if last is None else (last.hash.hex(), last.sequence)


def _memory() -> str:
    """Return a folder in memory if there is one: no file of a session outlives it."""
    shared = Path("/dev/shm")  # noqa: S108  # names in it are made by mkdtemp
    return str(shared) if shared.is_dir() else tempfile.gettempdir()


def _drop(_logger: object, _method: str, _event: object) -> NoReturn:
    raise structlog.DropEvent


@contextmanager
def quiet() -> Iterator[None]:
    """Drop all log messages during the context, since writing them costs more than everything else."""
    before = structlog.get_config()
    structlog.configure(processors=[_drop], wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    try:
        yield
    finally:
        structlog.configure(**before)


__all__ = ["ExplorationResult", "InvariantViolation", "quiet", "run_session"]
