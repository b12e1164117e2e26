"""Measurements at the receiver: forces over a limit, dropped set points, and the kernel's count of segments."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from pcmrs.messages import DeviceHealth, JointState
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.receivers import (
    Segments,
    dropped_setpoints,
    flange_forces,
    forces_over_limit,
    segments,
)
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run


def joints(force: tuple[float, float, float] | None) -> JointState:
    zeros = [0.0] * 7
    return JointState(captured=0.0, sent=0.0, positions=zeros, velocities=zeros, torques=zeros, flange_force=force)


def health(**dropped: int) -> DeviceHealth:
    return DeviceHealth(device="robot", connected=True, dropped=dropped)


async def test_forces_are_magnitudes_of_what_a_client_receives() -> None:
    cell = ScriptedCell()
    async with flange_forces(cell.as_cell) as forces:
        for force in ((3.0, 4.0, 0.0), None, (0.0, 0.0, -30.0)):
            cell.client.handlers["state/joints"](joints(force))
    assert forces == [5.0, 30.0]
    assert cell.client.handlers == {}, "it listens no longer"
    assert forces_over_limit(forces, 25.0) == {"most_newtons": 30.0, "states over the limit": 1}


@pytest.mark.parametrize("forces", [[], [24.0, 25.0]])
def test_a_force_that_never_exceeds_the_limit_was_no_fault(forces: list[float]) -> None:
    with pytest.raises(Unmet, match=rf"over 25 N: at most {max(forces, default=0.0):.1f} N"):
        forces_over_limit(forces, 25.0)


def test_the_present_count_is_one_made_after_the_question(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first message after the question may have been sent before it."""

    async def count() -> int:
        cell, loop = ScriptedCell(), asyncio.get_running_loop()
        async with dropped_setpoints(cell.as_cell, "setpoints") as counts:
            take = cell.client.handlers["dev/robot/state"]
            take(health(setpoints=1))
            for after, number in ((0.5, 2), (1.0, 3), (1.5, 4)):
                loop.call_later(after, take, health(setpoints=number))
            return await counts.current()

    assert run(monkeypatch, count()) == 3


def test_an_increase_is_that_of_the_own_kind_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    async def increase(**dropped: int) -> int:
        cell = ScriptedCell()
        async with dropped_setpoints(cell.as_cell, "stale_setpoints") as counts:
            take = cell.client.handlers["dev/robot/state"]
            take(health())
            asyncio.get_running_loop().call_later(0.5, take, health(**dropped))
            return await counts.increase_since(2)

    assert run(monkeypatch, increase(stale_setpoints=5, setpoints=9)) == 3
    with pytest.raises(Unmet, match="No set point was dropped as one of its stale_setpoints"):
        run(monkeypatch, increase(setpoints=9))


def test_a_node_that_is_silent_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    async def count() -> int:
        async with dropped_setpoints(ScriptedCell().as_cell, "setpoints") as counts:
            return await counts.current()

    with pytest.raises(Unmet, match="publishes no health"):
        run(monkeypatch, count())


def test_segments_of_a_request_are_counted_from_a_time_on() -> None:
    since = Segments(received=30, sent=14).since(Segments(received=10, sent=4))
    assert (since, since.per_request) == (Segments(20, 10), 2.0)
    assert Segments(3, 0).per_request == 0.0


@pytest.mark.parametrize(
    ("shown", "found"),
    [
        ("ESTAB 0 0\n\t cubic data_segs_out:12 data_segs_in:34 bytes:5\n", Segments(34, 12)),
        ("", None),
        ("data_segs_out:1 data_segs_in:2\ndata_segs_out:3 data_segs_in:4\n", None),
    ],
)
async def test_the_kernels_counts_are_those_of_one_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shown: str, found: Segments | None
) -> None:
    (tmp_path / "ss").write_text(f"#!/bin/sh\ncat <<'END'\n{shown}END\n")
    (tmp_path / "ss").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    if found is not None:
        assert await segments(30001) == found
        return
    with pytest.raises(Unmet, match="does not show one connection to port 30001"):
        await segments(30001)
