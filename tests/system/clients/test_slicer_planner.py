"""The core of the Slicer module, driven by a real Qt timer, against a real daemon."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.gateway.signing import new_key
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import accept, plan, reset_cell
from tests.system.clients.slicer_program import Cell, Program, core, lossy_way, running_cell

qt: Any = pytest.importorskip("PySide6.QtCore", reason="PySide6 is not installed: pip install PySide6-Essentials")
link = core()

PLANNED = msgspec.to_builtins(plan())
LANDMARKS_MM = [[1e3 * value for value in each["position"]] for each in PLANNED["landmarks"]]
UNSIGNED = "127.0.0.2"
"""Unsigned commands are taken from here only."""
LOOK = 0.25
"""Seconds between two looks at an arm that stands."""


class Desk:
    """Who sits before Slicer: a planner, what OpenIGTLink tells, and the event loop that ticks both.

    Args:
        port: The daemon's, or of a way to it.
        settings: Of the link; it signs unless told.
    """

    def __init__(self, cell: Cell, port: int | None = None, **settings: Any) -> None:
        signer = link.Signer("slicer", link.read_key(str(_key(cell.cell.folder))), answers_signed=True)
        ours = {"pose_port": cell.pose_port, "point_port": cell.point_port, "signer": signer}
        self.link = link.Link(port=port or cell.port, **{**ours, **settings})
        self.planner = link.Planner(self.link)
        self.feed = link.Feed(port=cell.feed_port)
        self.program = Program(qt, self.link.tick, self.feed.tick)

    def seen_now(self) -> set[str]:
        """Transforms that the panel shows as seen now."""
        return {name for name, _, age in link.panel.pose_rows(self.link, self.feed) if age == "now"}

    def accepted(self, begin: Callable[..., None], *arguments: Any) -> Any:
        verdict = self.program.verdict(begin, *arguments)
        assert verdict.accepted, link.explain(verdict)
        return verdict

    def act(self, *titles: str) -> Any:
        """Presses the buttons, each when the one before was accepted."""
        return [self.accepted(self.planner.act, title) for title in titles][-1]

    def register(self) -> None:
        self.act("Connect robot")
        self.accepted(self.planner.plan_landmarks, LANDMARKS_MM)
        self.act("Digitize all", "Register")

    def plan_tool(self) -> Any:
        pose = PLANNED["poses"][0]
        meant = link.Pose(tuple(1e3 * value for value in pose["position"]), tuple(pose["quat_xyzw"]))
        self.accepted(self.planner.plan_tool, link.pose_of_matrix(meant.matrix))
        return meant


@contextmanager
def desk(cell: Cell, port: int | None = None, **settings: Any) -> Iterator[Desk]:
    opened = Desk(cell, port, **settings)
    try:
        yield opened
    finally:
        opened.link.close()
        opened.feed.close()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    folder = tmp_path_factory.mktemp("cell")
    new_key(_key(folder))
    settings = (
        f'gateway.unsigned_peers=["{UNSIGNED}"]',
        f"gateway.peers.slicer.key_file={_key(folder)}",
        "gateway.peers.slicer.role=operator",
        "gateway.peers.slicer.counter=unix_ns",
        'gateway.peers.slicer.allow=["read","stream","plan","digitize","register","robot","motion"]',
        *LIGHT,
        "sim.tracker.rate_hz=30",  # a program that does not tick for a second has a backlog
        "cell.rate=2",  # what is quicker fails on a machine that does much else
        "robot.deadman=1.0",  # likewise: such a machine leaves a daemon alone for so long, and the arm would be held
        "procedure.motion.linear_velocity=0.25",  # slow enough to be stopped on the way
    )
    with running_cell(folder, *settings) as cell:
        yield cell


def _key(folder: Path) -> Path:
    return folder / "slicer.key"


@pytest.fixture
def cell(shared: Cell) -> Cell:
    shared.ask(reset_cell(shared.cell.client))
    return shared


def test_workflow_from_planned_landmarks_to_placement_and_home(cell: Cell) -> None:
    after = cell.cell.last_row()
    with desk(cell) as slicer:
        assert slicer.program.verdict(slicer.planner.hello).reason == "no_data"  # heard: there are no joints yet
        slicer.register()
        assert 0.1 < slicer.planner.residual < 4.0
        target = slicer.plan_tool()
        slicer.act("Approach", "Show tool", "Confirm")
        placed = slicer.planner.placement
        assert placed.translation_error < 1.0
        assert np.allclose(placed.pose.position, target.position, rtol=0.0, atol=1.0)

        # What is seen now, by both ways, is the tool at its target, in mm and RAS.
        slicer.link.seen.clear()
        slicer.feed.seen.clear()
        slicer.program.until(lambda: "tool" in slicer.link.seen and "CoilToImage" in slicer.feed.seen)
        for shown in (slicer.link.seen["tool"].value, slicer.feed.seen["CoilToImage"].value):
            assert np.allclose(shown.position, target.position, rtol=0.0, atol=2.0)
            assert np.allclose(shown.matrix, target.matrix, rtol=0.0, atol=2.0)

        slicer.program.until(lambda: slicer.seen_now() >= {"PcmrsTool", "PcmrsBody", "PcmrsTarget"})
        assert link.panel.results(slicer.planner)[0].startswith("Residual ")

        # A motion is refused as busy while it is being decided that the tool is aligned.
        slicer.program.until(lambda: (slicer.feed.state.branches["alignment"], slicer.feed.state.running) == ("1", []))
        slicer.act("Back off", "Home", "Hide tool")
        slicer.program.until(lambda: slicer.feed.state.branches["placement"] == "retracted")
        shown, truth = slicer.feed.state, cell.ask(cell.cell.client.state())
        assert (shown.branches, shown.latched, shown.plan) == (truth.branches, truth.latched, truth.plan)
        assert ("placement", "retracted", "now") in link.panel.branch_rows(slicer.planner, slicer.feed)
        assert ("placement", "retracted") in [row[:2] for row in link.panel.branch_rows(slicer.planner, None)]
        assert not slicer.planner.refusals
    assert cell.outcomes("peer:slicer", after) == [
        "accepted robot.connect",
        "accepted registration.plan_landmarks",
        "accepted digitization.digitize_all",
        "accepted registration.register",
        "accepted toolplan.plan",
        "accepted placement.approach",
        "accepted placement.confirm",
        "accepted placement.back_off",
        "accepted placement.home",
    ]


def test_refused_operation_gives_its_reason_and_the_next_one_too(cell: Cell) -> None:
    with desk(cell) as slicer:
        verdict = slicer.program.verdict(slicer.planner.act, "Approach")
        assert (verdict.decision, verdict.branch) == ("rejected", "placement")
        (refusal,) = slicer.planner.refusals
        assert refusal.title == "Approach"
        assert verdict.reason in refusal.text
        assert slicer.planner.known["placement"].state == verdict.state

        assert slicer.program.verdict(slicer.planner.plan_landmarks, LANDMARKS_MM[:2]).reason == "too_few_landmarks"
        assert slicer.planner.refusals[-1].title == "Plan landmarks"
        slicer.act("Connect robot")


def test_backlog_is_taken_in_one_tick_and_the_newest_is_shown(cell: Cell) -> None:
    with desk(cell) as slicer:
        slicer.register()
        slicer.act("Show tool")
        slicer.program.until(lambda: "tool" in slicer.link.seen)
        backlog = 0
        for _ in range(10):  # a busy machine may leave the daemon alone, too, and then little has come
            if backlog <= 20:
                before = slicer.link.counts.received
                time.sleep(1.0)  # the program loads a volume, say: no tick, while the daemon sends on
                slicer.link.tick()
                backlog = slicer.link.counts.received - before
        slicer.link.tick()
        assert backlog > 20
        assert slicer.link.counts.received - before - backlog < backlog / 4
        slicer.act("Hide tool")

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as daemon:
            slicer.program.until(lambda: slicer.link.age("tool") > 0.1)
            for number in range(200):
                text = f"__msg_pose_{number}.0_0.0_0.0_0.0_0.0_0.0_1.0"
                daemon.sendto(text.encode(), ("127.0.0.1", cell.pose_port))
        slicer.link.tick()
        assert slicer.link.seen["tool"].value.position[0] == 199.0
        assert slicer.link.counts.dropped == 0


def test_a_lost_reply_is_asked_for_again_and_nothing_runs_twice(cell: Cell) -> None:
    after, heard = cell.cell.last_row(), Counter[str]()

    def lost(way: str, data: bytes) -> bool:
        """Of each command the first reply, and of each second command the first datagram as well."""
        command = data.decode().partition(";")[0]
        number = command.rpartition("#")[2] if way == "to" else command.partition("_")[0]
        heard[way + number] += 1
        return heard[way + number] == 1 and (way == "from" or int(number) % 2 == 0)

    with lossy_way(cell.port, lost) as port, desk(cell, port) as slicer:
        slicer.register()
        slicer.plan_tool()
        slicer.act("Approach")
        slicer.accepted(slicer.planner.nudge, [0.0, 0.0, 2.0])
        assert slicer.link.counts.repeated > 10
    outcomes = Counter(cell.outcomes("peer:slicer", after))
    assert outcomes["accepted placement.nudge"] == 1
    assert set(outcomes.values()) == {1}, outcomes


def test_command_lost_before_a_stop_is_not_resent_after_it(cell: Cell) -> None:
    def lost(way: str, data: bytes) -> bool:
        return way == "to" and data.startswith(b"execute_motionxx")

    clock = _Clock()
    with lossy_way(cell.port, lost, UNSIGNED) as port, desk(cell, port, signer=None, clock=clock) as slicer:
        slicer.register()
        slicer.plan_tool()
        answers: list[Any] = []
        slicer.planner.act("Approach", then=answers.append)
        slicer.program.until(lambda: slicer.link.counts.repeated > 2)
        assert slicer.program.verdict(slicer.planner.stop).accepted
        repeated = slicer.link.counts.repeated
        cell.ask(accept(cell.cell.client, "robot.acknowledge"))
        clock.hurry(10.0)
        slicer.program.until(lambda: bool(answers))
        assert (answers[0].decision, answers[0].reason) == ("unknown", "no_answer")
        assert slicer.link.counts.repeated == repeated
    assert cell.ask(cell.cell.client.state()).branches["placement"] == "retracted"


def test_points_from_mixed_reality_are_a_tool_pose(cell: Cell) -> None:
    with desk(cell) as slicer, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as headset:
        headset.bind((UNSIGNED, 0))
        headset.sendto(b"__msg_toolpose_4.0_-12.0_143.0_4.0_-12.0_193.0", ("127.0.0.1", cell.port))
        slicer.program.until(lambda: "tool_points" in slicer.link.seen)
        pose = slicer.planner.relayed_tool()
        assert np.allclose(pose.position, [4.0, -12.0, 143.0])
        assert np.allclose(np.array(pose.matrix)[:3, :3], np.eye(3))


def test_command_without_a_listener_is_unknown_with_the_reason(cell: Cell) -> None:
    with desk(cell, free_port(), clock=_Clock(10.0)) as slicer:
        verdict = slicer.program.verdict(slicer.planner.hello)
        assert (verdict.decision, verdict.reason) == ("unknown", "nobody_listens")
        assert slicer.link.under_way is None


def test_one_job_at_a_time(cell: Cell) -> None:
    with desk(cell) as slicer:
        answers: list[Any] = []
        slicer.planner.act("Connect robot", then=answers.append)
        with pytest.raises(link.BusyError, match="Connect robot"):
            slicer.planner.act("Register")
        slicer.program.until(lambda: bool(answers))
        assert answers[0].accepted


def test_client_that_does_not_sign_gets_no_answer(cell: Cell) -> None:
    after = cell.cell.last_row()
    for signer in (None, link.Signer("slicer", bytes(32))):
        with desk(cell, signer=signer, clock=_Clock(20.0)) as slicer:
            verdict = slicer.program.verdict(slicer.planner.act, "Connect robot")
            assert (verdict.decision, verdict.reason) == ("unknown", "no_answer")
    assert cell.ask(cell.cell.client.state()).branches["robot"] == "0"
    assert not cell.outcomes("", after)


def test_stop_in_motion(cell: Cell) -> None:
    with desk(cell) as slicer:
        slicer.register()
        slicer.plan_tool()
        ended: list[Any] = []
        before = _joints(cell)
        slicer.planner.act("Approach", then=ended.append)
        slicer.program.until(lambda: np.abs(np.subtract(_joints(cell), before)).max() > 1e-3)
        slicer.program.until(lambda: slicer.feed.state.running == ["placement.approach"])
        assert link.panel.status(slicer.planner, slicer.feed).startswith("Approach: ")
        assert slicer.program.verdict(slicer.planner.stop).accepted
        slicer.program.until(lambda: bool(ended))
        assert (ended[0].decision, ended[0].state) == ("failed", "held")
        assert ended[0].reason in ("stopped", "motion_stopped")
        slicer.program.until(lambda: slicer.feed.state.latched)
        assert "latched" in link.panel.status(slicer.planner, slicer.feed)
        stood = _joints(cell)
        time.sleep(LOOK)
        assert np.allclose(_joints(cell), stood, rtol=0.0, atol=1e-3)
        assert slicer.program.verdict(slicer.planner.act, "Back off").reason == "latched"
        assert "acknowledge" in slicer.planner.refusals[-1].text


def _joints(cell: Cell) -> list[float]:
    joints: list[float] = cell.ask(cell.cell.client.request_device("robot", "joints"))["positions"]
    return joints


class _Clock:
    """A clock that shortens the time limits of a link.

    Args:
        rate: Seconds of it per second of the machine.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self._since = self._shown = time.monotonic()
        self._rate = rate

    def __call__(self) -> float:
        return self._shown + self._rate * (time.monotonic() - self._since)

    def hurry(self, rate: float) -> None:
        """Goes so many times as fast from now on."""
        self._shown, self._since, self._rate = self(), time.monotonic(), rate
