"""Stop in simulated time: long-lived cells, each stopped repeatedly at random moments of its motions.

A cell consists of daemon, journal, device node and simulated arm on one seeded clock, as the explorer runs it, and the
explorer's witness checks all events against its invariants. The arm has no dynamics: it is exactly where its set points
are, so that after a confirmed Stop it must not move at all. Every second cell is undisturbed, and its times must keep
their limits. In the others messages are doubled and overtaken, and one hand-over, reply or write in ten takes up to
0.5 s: there only the motion of the arm counts, and that Stop is confirmed.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import random
import tempfile
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from stop_found import BREATHING, LATCHED, STANDSTILL, Braking, Found, farthest

from pcmrs.dispatcher import DispatcherListener
from pcmrs.journal import JournalReader
from pcmrs.messages import Command, DeviceEvent, HeadMotion, JointState, Snapshot, Verdict
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.spatial import Floats
from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs_lab.campaign.explore.operators import Operators
from pcmrs_lab.campaign.explore.session import quiet
from pcmrs_lab.campaign.explore.settings import settings_of, workflow_of
from pcmrs_lab.campaign.explore.witness import Witness
from pcmrs_sim.deterministic.cell import Devices, SimulatedCell, simulated_cell
from pcmrs_sim.deterministic.daemon import ProcedureDispatcher
from pcmrs_sim.deterministic.entropy import seeded_entropy

MOTIONS: dict[str, tuple[str, dict[str, Any], float]] = {
    "approach": ("retracted", {}, 2.5),
    "confirm": ("standoff", {}, 2.0),
    "nudge": ("placed", {"translation": [0.0, 0.0, 0.004]}, 0.8),
    "press": ("placed", {"force": 3.0}, 1.5),
    "follow": ("placed", {}, 3.0),
}
"""State in which each motion begins, its arguments, and the time within which Stop is pressed, s of the cell."""

ROUTES: dict[str, Callable[[Operators], None]] = {
    "bus": lambda operators: operators.stop("anna"),
    "wire": lambda operators: operators.old_client("stop_now_xxxxxxx", ()),
}
PER_CELL = 100
"""Number of Stops of one cell; then another one is started with other errors."""
SLOW, REORDERING, DUPLICATES = 0.1, 0.1, 0.05
"""Of a disturbed cell: parts of the windows, and of the messages."""
CONFIRMED = 10.0
"""Time within which Stop must be confirmed, s of the cell."""
QUIET = (0.6, 2.0)
"""Range of the time without any command after a confirmed Stop, s: longer than any message is in transit."""
LOOK = 0.05
STEPS = 60
"""Number of steps towards the start of a motion after which an operator gives up."""
EXACT = 1e-6
"""Tolerance for rounding, and for the overshoot of the spline through the samples of a brake, rad."""

READY: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {
    "registration": {
        "000": ("registration.plan_landmarks", landmarks()),
        "100": ("digitization.digitize_all", {}),
        "110": ("registration.register", {}),
    },
    "toolplan": {"0": ("toolplan.plan", tool_pose())},
    "placement": {
        "unknown": ("placement.locate", {}),
        "held": ("placement.back_off", {}),
        "following": ("placement.back_off", {}),
    },
}
"""Next operation, by branch and state, independent of the wanted placement."""
ON: dict[tuple[str, str], str] = {
    ("standoff", "retracted"): "placement.home",
    ("placed", "retracted"): "placement.home",
    ("retracted", "standoff"): "placement.approach",
    ("placed", "standoff"): "placement.back_off",
    ("retracted", "placed"): "placement.approach",
    ("standoff", "placed"): "placement.confirm",
}
"""Operation that leads from a placement towards another."""

Progress = Callable[[Found], None]


class _LostError(Exception):
    """The cell cannot be brought to the start of a motion; a new one is started."""


class _ReportingRobot:
    """Simulated robot that reports calls of `hold`."""

    def __init__(self, robot: Any, held_at: Callable[[], None]) -> None:
        self._robot, self._on_hold = robot, held_at

    def __getattr__(self, name: str) -> Any:
        return getattr(self._robot, name)

    async def hold(self) -> JointState:
        self._on_hold()
        state: JointState = await self._robot.hold()
        return state


class _Cell(DispatcherListener):
    """Cell, and observations of the present Stop.

    Args:
        found: Results.
        witness: Witness of the cell.
        draw: Source of motions, routes and moments.
    """

    def __init__(self, found: Found, witness: Witness, draw: random.Random) -> None:
        self._found, self._witness, self._draw = found, witness, draw
        self._loop = asyncio.get_running_loop()
        self._arm: Any = None
        self._number = 0
        self._last: Verdict | None = None
        self._forget()

    def _forget(self) -> None:
        self.latched: float | None = None
        self.braking: Braking | None = None
        self.rested: float | None = None
        self.held_at: float | None = None
        self.confirmed: float | None = None
        self._confirming: asyncio.Future[None] = self._loop.create_future()
        self._stood: Floats | None = None
        self._moved = self._beyond = 0.0

    def watched(self, devices: Devices) -> Devices:
        """Return the devices that the node serves, wrapped for observation."""
        self._arm = devices["scene"].arm
        return {**devices, "robot": _ReportingRobot(devices["robot"], self._take_hold)}

    def observe(self, dispatcher: ProcedureDispatcher, reader: JournalReader) -> None:
        """Observe a new run of the daemon.

        Args:
            dispatcher: Dispatcher of the run.
            reader: Reader of its journal.
        """
        self._witness.observe(dispatcher, reader)
        dispatcher.add_listener(self)

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        if not isinstance(message, Snapshot) or message.stop.number <= self._number:
            return
        if message.latched and self.latched is None:
            self.latched = self._loop.time()
        if message.stop.confirmed and self.confirmed is None:
            self.confirmed, self._stood = self._loop.time(), np.array(self._arm.positions)
            self._confirming.set_result(None)

    def _answered(self, command: Command, verdict: Verdict) -> None:
        self._last = verdict
        self._witness.answered(command, verdict)

    def _take_hold(self) -> None:
        if self.held_at is None:
            self.held_at = self._loop.time()
            reference = self._arm.reference
            if not reference.ended:
                self.braking = Braking.at(self.held_at, reference.position.tolist(), reference.velocity.tolist())

    def look(self) -> None:
        """Observe the simulated arm after a step."""
        if self._stood is not None:
            self._moved = max(self._moved, farthest(self._stood, [self._arm.positions]))
        elif self.braking is not None:
            self._beyond = max(self._beyond, self.braking.beyond(self._arm.positions))
            if self.rested is None and self._arm.at_rest:
                self.rested = self._loop.time()

    async def run(self, cell: SimulatedCell, stops: int) -> None:
        """Stop a cell a number of times.

        Args:
            cell: Simulated cell.
            stops: Number of Stops.
        """
        operators = Operators(cell, self._answered, self._witness.watcher)
        for _ in range(stops):
            await self._stop_one(operators, cell)
            if self._witness.violation is not None:
                return

    async def _stop_one(self, operators: Operators, cell: SimulatedCell) -> None:
        name, route = self._draw.choice(list(MOTIONS)), self._draw.choice(list(ROUTES))
        place, arguments, latest = MOTIONS[name]
        await self._bring(operators, place)
        if name == "follow":
            await cell.devices["scene"].set_motion(BREATHING)
        motion = asyncio.create_task(operators.operate("ben", f"placement.{name}", arguments))
        await asyncio.sleep(self._draw.uniform(0.0, latest))
        self._number = self._shown().stop.number
        self._forget()
        pressed = self._loop.time()
        ROUTES[route](operators)
        await asyncio.wait([self._confirming], timeout=CONFIRMED)
        await cell.devices["scene"].set_motion(HeadMotion())
        if self.confirmed is None:
            self._found.wrong.append(f"{name} by {route}: Stop was not confirmed within {CONFIRMED:g} s.")
        else:
            await asyncio.sleep(self._draw.uniform(*QUIET))
            self._note(f"{name} by {route}", pressed, disturbed=cell.network.windows.share > 0.0)
        await asyncio.wait([motion], timeout=CONFIRMED)

    def _note(self, what: str, pressed: float, *, disturbed: bool) -> None:
        found, prefix = self._found, "disturbed: " if disturbed else ""
        found.pressed[what] += 1
        found.moved.append(self._moved)
        if self._moved > EXACT:
            found.wrong.append(f"{what}: a joint moved by {self._moved:.3g} rad after a confirmed Stop.")
        for name, begun, ended in (
            (LATCHED, pressed, self.latched),
            ("pressed to hold at the driver", pressed, self.held_at),
            ("pressed to confirmed", pressed, self.confirmed),
            (STANDSTILL, self.held_at, self.rested),
        ):
            if begun is not None and ended is not None:
                found.times[prefix + name].append(ended - begun)
        if self.braking is not None:
            found.moving[what] += 1
            found.beyond.append(self._beyond)
            if self._beyond > EXACT:
                found.wrong.append(f"{what}: a joint went {self._beyond:.3g} rad beyond its braking distance.")

    async def _bring(self, operators: Operators, place: str) -> None:
        """Perform the steps that lead to a placement, like an operator who watches the state.

        Raises:
            _LostError: No step leads there.
        """
        for _ in range(STEPS):
            shown = self._shown()
            if shown.running or shown.stop.pending:
                await asyncio.sleep(4 * LOOK)
                continue
            step = _next(shown, place)
            if step is None:
                return
            await operators.operate("anna", *step)
            await asyncio.sleep(LOOK)  # publications are in transit
        reason = self._last.reason if self._last is not None else None
        why = "" if reason is None else f", {reason.code}: {reason.text}"
        raise _LostError(f"{place}: placement {self._shown().branches['placement']}{why}")

    def _shown(self) -> Snapshot:
        """Return the snapshot that was published last; operators of a disturbed cell may receive an older one later."""
        snapshot = self._witness.view.snapshot
        if snapshot is None:
            raise _LostError("no daemon runs")
        return snapshot


def _next(shown: Snapshot, place: str) -> tuple[str, dict[str, Any]] | None:
    """Return the next step to a placement; None if it is reached."""
    states = shown.branches
    if states["robot"] == "0":
        return "robot.connect", {}
    if shown.latched:
        return "robot.acknowledge", {"stop": shown.stop.number}
    for branch, steps in READY.items():
        if states[branch] in steps:
            return steps[states[branch]]
    if states["placement"] == place:
        return None
    return ON[states["placement"], place], {}


def run_cell(seed: int, stops: int) -> tuple[Found, int]:
    """Stop the cell of a seed a number of times; the process must do nothing else meanwhile.

    Args:
        seed: Seed of the cell.
        stops: Number of Stops.

    Returns:
        Results, and the number of Stops that were left when the cell could not be brought to another motion.
    """
    found = Found()
    with tempfile.TemporaryDirectory(prefix="pcmrs-stop-") as folder, seeded_entropy(seed), quiet():
        loop = SimulatedLoop()
        try:
            loop.run_until_complete(_run(found, seed, stops, Path(folder) / "journal.sqlite"))
        finally:
            loop.close()
    found.notes["simulated, s"] += round(loop.time())
    return found, stops - found.pressed.total()


async def _run(found: Found, seed: int, stops: int, path: Path) -> None:
    workflow = workflow_of("ratms")
    witness = Witness(workflow.blueprint)
    own = _Cell(found, witness, random.Random(f"stop {seed}"))
    async with simulated_cell(
        settings_of("ratms", "kinematic", seed),
        workflow,
        path,
        seed,
        watched=lambda devices: own.watched(witness.watched(devices)),
        observe=own.observe,
    ) as cell:
        if seed % 2:
            cell.network.windows.share = SLOW
            cell.network.conditions.reordering, cell.network.conditions.duplicates = REORDERING, DUPLICATES
        scene = cell.devices["scene"]
        with witness.watching(scene), scene.watched(own.look):
            try:
                await own.run(cell, stops)
            except _LostError as lost:
                found.notes[f"given up at {lost}"] += 1
    if witness.violation is not None:
        found.wrong.append(f"seed {seed}: {witness.violation}")


def run_all(stops: int, seed: int, jobs: int, progress: Progress = lambda _: None) -> Found:
    """Stop cells in several processes until the number of Stops is reached.

    Args:
        stops: Number of Stops.
        seed: Seed of the first cell; the others have the following ones.
        jobs: Number of processes.
        progress: Called with the results so far.
    """
    found, seeds, running = Found(), count(seed), set[Future[tuple[Found, int]]]()
    scheduled = 0
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        while True:
            while scheduled < stops and len(running) < 2 * jobs and not found.wrong:
                some = min(PER_CELL, stops - scheduled)
                scheduled += some
                running.add(pool.submit(run_cell, next(seeds), some))
            if not running:
                return found
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                part, left = each.result()
                found.add(part)
                scheduled -= left
            progress(found)
