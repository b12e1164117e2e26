"""Injects faults into a simulated cell, and ends them when their time is over."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.messages import Verdict
from pcmrs.testing.detector import ScriptedDetector
from pcmrs_lab.campaign.explore.faults import DETECTOR, HOST, NETWORK, SCENE
from pcmrs_lab.campaign.explore.operators import Operators
from pcmrs_lab.campaign.explore.witness import Witness
from pcmrs_sim.deterministic.cell import NODE, SimulatedCell

BY_HAND = 3.0
"""Time for which an arm may still move after an external force has ended, s."""
RETRY_AFTER = 2.0
"""Time after which a daemon that has not started is started again, s."""
ATTEMPTS = 60
"""Number of attempts to start a daemon: they take longer than any fault lasts."""
FLOOD = 60
"""Number of times that a flooding detector sends each event."""
FROM_OUTSIDE = ("guide_by_hand", "offset_joint", "push_tool")
"""Faults that move the arm away from its commanded motion."""
MOVES = ("shift_body", "bump_reference", "dash_head")
"""Faults that move a tracked body, perhaps to where another one was."""


class Faults:
    """Faults that are present in one cell.

    Args:
        cell: Cell into which they are injected.
        operators: Operators, whose clock may be wrong.
        witness: Witness, which learns what it may not count as a violation.
        detector: Detector of a watched scene; None if nobody watches it.

    Attributes:
        reached: Number of times that each fault was injected.
        mistaken: True if a feed of poses has restarted, or a body has moved, while two tools were swapped, or if they
            were swapped while the feed did not see both where they are. No feed can then tell the bodies apart, and the
            tracker has to be restarted.
    """

    def __init__(
        self,
        cell: SimulatedCell,
        operators: Operators,
        witness: Witness,
        detector: ScriptedDetector | None = None,
    ) -> None:
        self.reached: Counter[str] = Counter()
        self._cell = cell
        self._operators = operators
        self._witness = witness
        self._detector = detector
        self.mistaken = False
        self._wrong: Counter[str] = Counter()
        self._ending: dict[asyncio.Task[None], None] = {}
        self._hosts: dict[str, Callable[[dict[str, Any]], Awaitable[None]]] = {
            "crash_daemon": self._crash_daemon,
            "end_daemon": self._end_daemon,
            "crash_node": self._crash_node,
            "held_up": self._block_process,
            "tracker_restart": self._restart_tracker,
            "frame_ahead": self._stamp_ahead,
            "slow_disk": self._slow_disk,
            "failing_disk": self._fail_disk,
            "wall_jump": self._jump,
            "wall_frozen": self._freeze,
            "skewed_operator": self._skew,
        }

    async def inject(self, name: str, given: dict[str, Any]) -> None:
        """Inject a fault, and end it after its argument `lasts`, s; skip one that the cell refuses.

        Args:
            name: Key of `FAULTS`, or of `DETECTOR`.
            given: Arguments from the script.
        """
        arguments = {key: value for key, value in given.items() if key != "lasts"}
        self._begin(name, arguments)
        try:
            await self._apply(name, arguments)
        except DeviceError:  # such as an arm that moves and cannot be guided by hand
            self._end(name)
            return
        self.reached[name] += 1
        task = asyncio.get_running_loop().create_task(self._end_later(name, arguments, float(given.get("lasts", 1.0))))
        self._ending[task] = None
        task.add_done_callback(self._ending.pop)

    async def wait_until_over(self) -> None:
        """Wait until no fault is present any more."""
        while self._ending:
            await asyncio.wait(tuple(self._ending))

    async def _end_later(self, name: str, arguments: dict[str, Any], lasts: float) -> None:
        await asyncio.sleep(lasts)
        if name in SCENE:
            end = SCENE[name].end
            if end is not None:
                await self._apply(name, arguments | dict(end))
        elif name in NETWORK:
            self._end_network(name)
        elif name in DETECTOR:
            self._show(name, on=False)
        else:
            await self._end_host(name)
        self._end(name)

    async def _apply(self, name: str, arguments: dict[str, Any]) -> None:
        if name in SCENE:
            await self._cell.devices["scene"].inject(name, arguments)
        elif name in NETWORK:
            self._harm_network(name, arguments)
        elif name in DETECTOR:
            self._show(name, on=True)
        else:
            await self._hosts[name](arguments)

    def _restart_poses(self) -> None:
        self.mistaken = self._wrong["tool_swap"] > 0

    def _unseen(self, bodies: Iterable[str]) -> bool:
        """Return True if the daemon's feed has no fresh pose of one of the bodies."""
        if self._cell.daemon is None or self._cell.daemon.procedure is None:
            return False  # a feed that starts later is restarted during the swap
        poses = self._cell.daemon.procedure.cell.poses
        return not all(poses.seen(body) for body in bodies)

    def _begin(self, name: str, arguments: dict[str, Any]) -> None:
        view = self._witness.view
        view.now = asyncio.get_running_loop().time()
        moved_in_swap = name in MOVES and self._wrong["tool_swap"] > 0
        swapped_at_first = name == "tool_swap" and self._unseen((arguments["first"], arguments["second"]))
        self.mistaken = self.mistaken or moved_in_swap or swapped_at_first
        self._wrong[name] += 1
        view.calm.set(False, view.now)
        if name in FROM_OUTSIDE:
            view.by_hand = float("inf")

    def _end(self, name: str) -> None:
        view = self._witness.view
        self._wrong[name] -= 1
        view.now = asyncio.get_running_loop().time()
        self._wrong += Counter()  # adding drops the entries at zero
        view.calm.set(not self._wrong, view.now)
        if name in FROM_OUTSIDE and not any(self._wrong[each] for each in FROM_OUTSIDE):
            view.by_hand = view.now + BY_HAND

    def _show(self, name: str, *, on: bool) -> None:
        detector = self._detector
        if detector is None:
            return
        if name == "hand_enters":
            detector.sees = {"hand": {}} if on else {}
        elif name == "camera_silent":
            detector.silent = on
        elif name == "camera_frozen":
            detector.frozen = on
        elif name == "camera_occluded":
            detector.blind = "occluded" if on else ""
        else:
            detector.repeats = FLOOD if on else 1

    def _harm_network(self, name: str, arguments: dict[str, Any]) -> None:
        conditions = self._cell.network.conditions
        if name == "partition":
            conditions.partition(arguments["from"], arguments["to"], both=arguments["both"])
        else:
            attribute = {"loss": "loss", "duplicates": "duplicates", "reordering": "reordering", "delay": "delay"}[name]
            setattr(conditions, attribute, float(arguments.get("part", arguments.get("seconds", 0.0))))

    def _end_network(self, name: str) -> None:
        if name == "partition":
            self._cell.network.conditions.cut.clear()
        else:
            self._harm_network(name, dict(NETWORK[name].end or {}))

    async def _end_host(self, name: str) -> None:
        if name == "crash_node":
            self._cell.start_node()
            self._restart_poses()
            self._witness.watcher.node_is_back(asyncio.get_running_loop().time())
        elif name in ("crash_daemon", "end_daemon"):
            await self.start_daemon()
        elif name == "failing_disk":
            self._cell.disk.failing = False
        elif name == "wall_frozen":
            self._cell.clock.freeze(False)
        elif HOST[name].end is not None:
            await self._hosts[name](dict(HOST[name].end or {}))

    async def start_daemon(self) -> None:
        """Start the daemon if there is none, and retry while a fault prevents the start."""
        error_text = ""
        for _ in range(ATTEMPTS):
            if self._cell.daemon is not None:
                break
            self._restart_poses()
            try:
                await self._cell.start_daemon()
            except PcmrsError as error:
                await self._crash_daemon({})
                error_text = error.text
                await asyncio.sleep(RETRY_AFTER)
        if self._cell.daemon is None:
            self._witness.break_("the_daemon_starts_again", error_text)
        else:
            reader = self._cell.daemon.journal.reader
            self._witness.watcher.check_rows(lambda source, command: _decision(reader.verdict_of(source, command)))

    async def _crash_daemon(self, _arguments: dict[str, Any]) -> None:
        self._witness.lose_daemon(crash=self._cell.daemon is not None)
        self._operators.snapshot = None
        await self._cell.crash_daemon()

    async def _end_daemon(self, _arguments: dict[str, Any]) -> None:
        await self._cell.end_daemon()
        self._witness.lose_daemon(crash=False)
        self._operators.snapshot = None

    async def _crash_node(self, _arguments: dict[str, Any]) -> None:
        self._witness.watcher.excuse_node(float("inf"))
        await self._cell.crash_node()

    async def _block_process(self, arguments: dict[str, Any]) -> None:
        process, seconds = str(arguments["process"]), float(arguments["seconds"])
        if process == NODE:
            self._witness.watcher.excuse_node(asyncio.get_running_loop().time() + seconds)
        else:
            self._witness.watcher.daemon_blocked(asyncio.get_running_loop().time(), seconds)
        self._cell.hold_up(process, seconds)

    async def _restart_tracker(self, _arguments: dict[str, Any]) -> None:
        if self._witness.tracker is not None:
            self._witness.tracker.restart()
            self._restart_poses()

    async def _stamp_ahead(self, _arguments: dict[str, Any]) -> None:
        if self._witness.tracker is not None:
            self._witness.tracker.stamp_ahead()

    async def _slow_disk(self, arguments: dict[str, Any]) -> None:
        self._cell.disk.delay = float(arguments["seconds"])

    async def _fail_disk(self, arguments: dict[str, Any]) -> None:
        self._witness.view.excused = True
        self._cell.disk.failing, self._cell.disk.landing = True, bool(arguments["landing"])

    async def _jump(self, arguments: dict[str, Any]) -> None:
        self._cell.clock.ahead = float(arguments["seconds"])

    async def _freeze(self, arguments: dict[str, Any]) -> None:
        self._cell.clock.freeze(bool(arguments["on"]))

    async def _skew(self, arguments: dict[str, Any]) -> None:
        self._operators.clock.ahead = float(arguments["seconds"])


def _decision(verdict: Verdict | None) -> str | None:
    return None if verdict is None else verdict.decision
