"""Actions of a campaign: a fault of the scene ends with its context, and a cell that does not follow proves nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import DeviceError
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import driving
from pcmrs_lab.campaign.driving import injected, to_following
from pcmrs_lab.campaign.fault import NotRun
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_cell import ScriptedCell, run


@pytest.mark.parametrize(
    ("begin", "end", "expected"),
    [
        (None, None, [{"on": True}, {"on": False}]),
        ({"marker": 2}, None, [{"marker": 2, "on": True}, {"marker": 2, "on": False}]),
        ({"rate": 5}, {"rate": 0}, [{"rate": 5}, {"rate": 0}]),
        ({"steps": 3}, {}, [{"steps": 3}]),
    ],
)
async def test_a_fault_of_the_scene_ends_with_its_context(
    begin: dict[str, Any] | None, end: dict[str, Any] | None, expected: list[dict[str, Any]]
) -> None:
    cell = ScriptedCell()
    async with injected(cell.as_cell, "occlude", begin, end):
        assert cell.scene.asked == [("occlude", expected[0])]
    assert cell.scene.asked == [("occlude", arguments) for arguments in expected]


async def test_it_ends_after_an_error_too_and_that_error_is_told() -> None:
    cell = ScriptedCell()
    cell.scene.errors["occlude"] = DeviceError("The scene is gone.")
    with pytest.raises(DeviceError, match="scene is gone"):
        async with injected(cell.as_cell, "occlude"):
            pass
    cell = ScriptedCell()

    async def move() -> None:
        cell.scene.errors["occlude"] = DeviceError("The scene is gone.")
        raise Unmet("It moved.")

    with pytest.raises(Unmet, match="It moved"):
        async with injected(cell.as_cell, "occlude"):
            await move()
    assert len(cell.scene.asked) == 2


async def test_an_end_that_fails_is_an_error() -> None:
    cell = ScriptedCell()
    with pytest.raises(DeviceError):
        async with injected(cell.as_cell, "occlude"):
            cell.scene.errors["occlude"] = DeviceError("The scene is gone.")


async def test_no_scene_is_changed_in_a_sham_campaign() -> None:
    cell = ScriptedCell()
    with sham():
        async with injected(cell.as_cell, "occlude"):
            pass
    assert cell.scene.asked == []


def placed(**branches: str) -> ScriptedCell:
    cell = ScriptedCell(Path("cell1"), registration="111", toolplan="1", placement="placed", **branches)
    cell.client.leads["placement.follow"] = {"placement": "following"}
    return cell


def test_a_tool_that_follows_is_followed_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = placed()
    run(monkeypatch, to_following(cell.as_cell.client))
    assert cell.client.asked[-1] == "placement.follow"


def test_a_cell_that_follows_never_is_too_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = placed(alignment="0")
    with pytest.raises(NotRun, match="too busy"):
        run(monkeypatch, to_following(cell.as_cell.client))


def test_a_cell_that_stops_following_is_too_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = placed()
    cell.client.leads["placement.follow"] = {"placement": "held"}
    with pytest.raises(NotRun, match=f"held within {driving.FOLLOWED:g} s"):
        run(monkeypatch, to_following(cell.as_cell.client))
