"""Rows of the bus: a link that is cut holds the arm, and a slow consumer is slow, and nobody else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.consumer import ConsumerReport, Manner
from pcmrs_lab.campaign.faults import network_bus
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run

IDLE = ConsumerReport(sent=100, received=100, counted=0, was="S")


class Link:
    """A remote cell behind a link; a cut stops the arm as a test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.cell = OperatedCell()
        self.log = folder / "remote" / "node.log"
        self.log.parent.mkdir()
        self.log.write_text("held_by_node\n")
        self.silent = 1.5
        self.held = True
        monkeypatch.setattr(network_bus, "remote_cell", self._open)
        monkeypatch.setattr(self.cell.client, "health", self._health)

    @asynccontextmanager
    async def _open(self, _: Any, impairment: InjectedImpairment) -> AsyncIterator[OperatedCell]:
        cell, holds = self.cell, self.held

        class Watched(InjectedImpairment):
            def __setattr__(self, name: str, value: Any) -> None:
                super().__setattr__(name, value)
                if name == "back" and holds and cell.client.running:
                    cell.client.hold()

        impairment.__class__ = Watched
        yield cell

    async def _health(self) -> Any:
        return SimpleNamespace(devices=[SimpleNamespace(heard=0.1), SimpleNamespace(heard=self.silent)])


@pytest.fixture
def link(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Link:
    return Link(monkeypatch, tmp_path)


@pytest.mark.parametrize(
    ("row", "measured"),
    [
        (network_bus.the_daemon_does_not_reach_the_robot, {"held_by_node"}),
        (network_bus.the_robot_does_not_reach_the_daemon, {"silent_s"}),
        (network_bus.a_half_open_link, {"held_by_node", "silent_s"}),
    ],
)
def test_a_cut_link_holds_the_arm(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, link: Link, row: Any, measured: set[str]
) -> None:
    found = run(monkeypatch, row(lab_of(tmp_path, link.cell)))
    assert proves(found)
    assert set(found.took_place) == measured
    assert found.control == {"approach": "accepted", "reached": "standoff"}


def test_a_node_that_does_not_hold_by_itself_is_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, link: Link
) -> None:
    link.log.write_text("")
    with pytest.raises(Unmet, match="node did not hold the arm by itself"):
        run(monkeypatch, network_bus.the_daemon_does_not_reach_the_robot(lab_of(tmp_path, link.cell)))


def test_a_node_that_was_heard_was_not_cut_off(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, link: Link) -> None:
    link.silent = 0.5
    with pytest.raises(Unmet, match=r"silent for 0\.50 s only"):
        run(monkeypatch, network_bus.the_robot_does_not_reach_the_daemon(lab_of(tmp_path, link.cell)))


def test_an_arm_that_moves_on_is_unmet(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, link: Link) -> None:
    link.held = False
    with pytest.raises(Unmet, match="expected state did not come"):
        run(monkeypatch, network_bus.a_half_open_link(lab_of(tmp_path, link.cell)))


def consumers(monkeypatch: pytest.MonkeyPatch, slow: ConsumerReport, idle: ConsumerReport = IDLE) -> list[Manner]:
    """Consumers that report this."""
    manners: list[Manner] = []

    @asynccontextmanager
    async def consumer(_: Any, manner: Manner) -> AsyncIterator[Any]:
        manners.append(manner)

        async def resume() -> ConsumerReport:
            return idle if manner == "idle" else slow

        yield resume

    monkeypatch.setattr(network_bus, "consumer", consumer)
    return manners


def test_a_consumer_without_time_loses_what_its_bus_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    manners = consumers(monkeypatch, ConsumerReport(sent=100, received=10, counted=85, was="S"))
    found = run(monkeypatch, network_bus.a_consumer_that_has_no_time(lab_of(tmp_path, OperatedCell())))
    assert manners == ["idle", "busy"]
    assert found.took_place == {"lost": 90, "counted": 85}
    assert found.control["heard_by_one_that_has_time"] == 100


def test_a_frozen_consumer_only_misses_frames(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    consumers(monkeypatch, ConsumerReport(sent=100, received=10, counted=0, was="T"))
    found = run(monkeypatch, network_bus.a_consumer_that_does_not_read(lab_of(tmp_path, OperatedCell())))
    assert found.took_place == {"lost": 90}


@pytest.mark.parametrize(
    ("slow", "row", "text"),
    [
        (ConsumerReport(100, 95, 5, "S"), network_bus.a_consumer_that_has_no_time, "was not too slow: it lost 5"),
        (ConsumerReport(100, 10, 20, "S"), network_bus.a_consumer_that_has_no_time, "its bus counted 20"),
        (ConsumerReport(100, 10, 0, "S"), network_bus.a_consumer_that_does_not_read, "was not frozen"),
    ],
)
def test_a_consumer_that_was_not_slow_proves_nothing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, slow: ConsumerReport, row: Any, text: str
) -> None:
    consumers(monkeypatch, slow)
    with pytest.raises(Unmet, match=text):
        run(monkeypatch, row(lab_of(tmp_path, OperatedCell())))


def test_one_that_has_time_must_lose_less(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    consumers(monkeypatch, ConsumerReport(100, 10, 90, "S"), ConsumerReport(100, 10, 90, "S"))
    with pytest.raises(Unmet, match="A consumer that has time lost 90"):
        run(monkeypatch, network_bus.a_consumer_that_has_no_time(lab_of(tmp_path, OperatedCell())))


def test_an_arm_is_looked_at_as_soon_as_it_can_be(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    truth, left = cell.scene.truth, [3]

    async def late() -> Any:
        left[0] -= 1
        if left[0] > 0:
            raise UnknownOutcomeError("Nobody answers.")
        return await truth()

    monkeypatch.setattr(cell.scene, "truth", late)
    assert run(monkeypatch, network_bus._check_stands_when_back(cell.as_cell)) == 0.0


def test_poses_that_arrive_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()

    async def count() -> int:
        async def send() -> None:
            while True:
                await asyncio.sleep(0.25)
                cell.client.tell("state/pose/coil", SimpleNamespace(frame_number=1))

        sending = asyncio.create_task(send())
        found = await network_bus._poses(cell.as_cell)
        sending.cancel()
        return found

    assert run(monkeypatch, count()) == pytest.approx(network_bus.LISTENED / 0.25, abs=1)
