"""The rows S and B of the fault catalogue: none is forgotten, and every way to bring one about works.

docs/faults.md is the list: each row, the faults that bring it about, the response, and the tests that prove it.
"""

from __future__ import annotations

import ast
import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs_sim.cell import CellSimulation, running_cell
from pcmrs_sim.cli.lines import apply_line, follow_schedule, read_schedule
from pcmrs_sim.faults import FAULTS, parse_fault
from tests import ROOT
from tests.unit.devices.fault_signs import SIGNS, connected

DOCUMENT = ROOT / "docs" / "faults.md"
LOOPS = {"simulated": SimulatedLoop}
ROWS = [f"{kind}{number}" for kind, last in (("S", 14), ("B", 15)) for number in range(1, last + 1)]
LINES: Mapping[str, tuple[str, str]] = {
    "occlude": ("coil on", "coil off"),
    "frame_frozen": ("on", "off"),
    "pose_nan": ("coil on", "coil off"),
    "pose_not_unit": ("coil on", "coil off"),
    "pose_jump": ("coil 60", "coil 0"),
    "not_measured": ("coil out_of_volume on", "coil out_of_volume off"),
    "bad_fit": ("coil on", "coil off"),
    "phantom_marker": ("coil on", "coil off"),
    "tool_swap": ("coil body_ref on", "coil body_ref off"),
    "wrong_tool": ("coil on", "coil off"),
    "tracker_rate": ("5", "0"),
    "stamp_reversed": ("on", "off"),
    "stamp_future": ("on", "off"),
    "tracker_unplugged": ("on", "off"),
    "tracker_absent": ("on", "off"),
    "bump_reference": ("4", "-4"),
    "shift_body": ("50", "-50"),
    "dash_head": ("86", "0"),
    "no_mep": ("on", "off"),
    "preactivation": ("30", "0"),
    "cut_robot": ("on", "off"),
    "silence_robot": ("on", "off"),
    "interrupt": ("", ""),
    "frame_replies": ("split", "whole"),
    "e_stop": ("on", "off"),
    "offset_joint": ("3 0.05", "3 0"),
    "change_mode": ("on", "off"),
    "close_brakes": ("on", "off"),
    "guide_by_hand": ("1 0.01", "1 -0.01"),
    "refuse_robot": ("on", "off"),
    "drop_client": ("", ""),
    "restart_cabinet": ("", ""),
    "late_set_point": ("on", "off"),
    "double_commands": ("on", "off"),
    "withdraw_servo": ("on", "off"),
    "push_tool": ("20", "0"),
}
"""Fault to the arguments that bring it about, and those that end it."""


@pytest.fixture
async def cell() -> AsyncIterator[CellSimulation]:
    clock = SimulatedClock(asyncio.get_running_loop())
    async with running_cell({"sim": {"arm": {"physics": "kinematic"}}}, clock) as cell:
        yield cell


@cache
def documented() -> dict[str, dict[str, str]]:
    """Row of the catalogue to the columns of its line in the document, each by its title."""
    lines = [line for line in DOCUMENT.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    titles = [title.strip() for title in lines[0].strip("|").split("|")]
    cells = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:])
    return {row[0]: dict(zip(titles, row, strict=True)) for row in cells if row[0] in ROWS}


def named(text: str) -> list[str]:
    """What stands between backquotes."""
    return re.findall("`([^`]+)`", text)


@cache
def defined_in(file: str) -> set[str]:
    """Names of the test functions of a file, those of its classes too."""
    tree = ast.parse((ROOT / "tests" / file).read_text(encoding="utf-8"))
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return {node.name for node in functions if node.name.startswith("test_")}


def test_every_row_is_in_the_document_once_and_in_order() -> None:
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    found = [line.split("|")[1].strip() for line in lines if line.startswith("|")]
    assert [row for row in found if row in ROWS] == ROWS


@pytest.mark.parametrize("row", ROWS)
def test_every_row_has_its_faults_its_response_and_its_tests(row: str) -> None:
    line = documented()[row]
    assert set(named(line["faults"])) == {fault.name for fault in FAULTS.values() if row in fault.rows} != set()
    assert line["response"]
    proofs = named(line["tests"])
    assert proofs
    for proof in proofs:
        file, _, name = proof.partition("::")
        assert name in defined_in(file), proof


def test_every_fault_belongs_to_a_row() -> None:
    assert {row for fault in FAULTS.values() for row in fault.rows} == set(ROWS)
    assert set(LINES) == set(FAULTS)


def test_every_fault_has_its_sign() -> None:
    assert set(SIGNS) == set(FAULTS)


Inject = Callable[[str], Awaitable[object]]
"""Brings a fault about, or ends it, by a line of text."""


async def check_brought_about(cell: CellSimulation, name: str, inject: Inject) -> None:
    """The fault shows between the line that begins it and the one that ends it, and the cell is healthy after that."""
    sign, (begin, end) = SIGNS[name], LINES[name]
    await connected(cell)
    before = await sign.look(cell)
    await sign.prepare(cell)
    await inject(f"{name} {begin}")
    await settled(cell)
    during = await sign.look(cell)
    assert sign.shows(before, during), (before, during)
    await inject(f"{name} {end}")
    await settled(cell)
    await healthy(cell)


@pytest.mark.parametrize("name", FAULTS)
async def test_a_line_brings_it_about_and_another_ends_it(cell: CellSimulation, name: str) -> None:
    await check_brought_about(cell, name, partial(apply_line, cell))


@pytest.mark.parametrize("name", FAULTS)
async def test_nothing_brings_no_fault_about(cell: CellSimulation, name: str) -> None:
    """So a sign is of its fault, and not of the time that has passed."""

    async def nothing(_: str) -> None: ...

    with pytest.raises(AssertionError):
        await check_brought_about(cell, name, nothing)


@pytest.mark.parametrize("name", FAULTS)
async def test_the_scene_brings_it_about_and_ends_it(cell: CellSimulation, name: str) -> None:
    scene: Any = cell.devices["scene"]

    async def inject(line: str) -> None:
        await scene.inject(*parse_fault(line))

    await check_brought_about(cell, name, inject)


@pytest.mark.parametrize("name", FAULTS)
async def test_a_schedule_brings_it_about_and_ends_it(cell: CellSimulation, tmp_path: Path, name: str) -> None:
    file = tmp_path / "faults.txt"

    async def inject(line: str) -> None:
        file.write_text(f"0 {line}\n", encoding="utf-8")
        await follow_schedule(cell, read_schedule(file))

    await check_brought_about(cell, name, inject)


async def test_a_schedule_has_all_of_them_at_a_time_and_ends_them(
    cell: CellSimulation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [f"{name} {LINES[name][which]}".strip() for which in (0, 1) for name in FAULTS]
    file = tmp_path / "faults.txt"
    file.write_text("".join(f"{0.05 * number:.2f} {line}\n" for number, line in enumerate(lines)), encoding="utf-8")
    schedule = read_schedule(file)
    assert [line for _, line in schedule] == lines
    following = asyncio.create_task(follow_schedule(cell, schedule))
    await cell.clock.sleep(0.05 * (len(FAULTS) - 0.5))
    robot, tracker = cell.robot_faults, cell.tracker.faults
    assert (robot.cut, robot.silent, robot.doubled, robot.late, robot.refusing) == (True,) * 5
    assert (robot.drives_off, robot.framing, robot.drops, robot.restarts) == ("brakes_closed", "split", 1, 1)
    assert (tracker.silent, tracker.frozen, tracker.reversed, tracker.future, tracker.plugged) == (*(True,) * 4, False)
    marked = (tracker.not_finite, tracker.not_unit, tracker.bad_fit, tracker.wrong_tools, tracker.phantoms)
    assert marked == ({"coil"},) * 5
    await following
    assert capsys.readouterr().err == "", "nothing was refused"
    await settled(cell)
    await healthy(cell)


async def settled(cell: CellSimulation) -> None:
    """Lets a fault act for a while, and what it moves come to rest."""
    await cell.clock.sleep(0.3)
    while not cell.world.arm.at_rest:
        await cell.clock.sleep(0.05)


async def healthy(cell: CellSimulation) -> None:
    """The robot answers and moves, and the tracker sees it, as if there had been no fault."""
    robot: Any = cell.devices["robot"]
    await robot.connect()
    session = (await robot.begin_servo()).session
    assert (await robot.end_servo(session)).reason in (None, "no_set_point")
    before = cell.devices["tracker"].newest  # type: ignore[union-attr]
    while (frame := cell.devices["tracker"].newest) is before or not frame:  # type: ignore[union-attr]
        await cell.clock.sleep(0.05)
    poses = {pose.body: pose for pose in frame}
    assert poses["coil"].valid
    assert poses["body_ref"].valid
    true = cell.world.tracker_from("coil")
    assert true is not None
    assert np.linalg.norm(poses["coil"].position - true.translation) < 1e-3
