"""A real daemon, guided over its bus by the command line and by a client."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.messages import TeleopSetpoint
from pcmrs.messages.teleop import Twist
from pcmrs.spatial import Transform
from pcmrs.teleop._twist_script import TwistScript
from pcmrs.teleop.session import TeleopSession
from pcmrs.testing.cell import LIGHT, RunningCell, open_cell
from pcmrs.testing.driving import accept, showing, to_standoff, until
from pcmrs.workflows.data import as_transform

PATIENT = (
    *LIGHT,
    "sim.tracker.rate_hz=30",
    "cell.rate=1",
    "robot.deadman=1.0",
    "procedure.following.longest_gap=0.2",
    "procedure.teleoperation.deadman=0.5",
    "procedure.teleoperation.slow_delay=1",
    "procedure.teleoperation.longest_delay=2",
)
"""A busy machine may be late itself."""
UP: Twist = (0.0, 0.0, 0.02, 0.0, 0.0, 0.0)
STILL = 5e-4
"""What an arm that stands gives way by, and less than what moves goes, m."""


def teleop_command(cell: RunningCell, script: Path) -> Sequence[str]:
    address = ("--endpoint", cell.ready.endpoint, "--site", cell.ready.prefix.split("/")[1], "--cell", cell.name)
    return (
        sys.executable,
        "-m",
        "pcmrs.cli",
        "teleop",
        *address,
        "--json",
        "--device",
        "script",
        "--script",
        str(script),
    )


async def height(cell: RunningCell) -> float:
    """Of the tool, along the axis it had when it was first looked at, m."""
    truth = await cell.scene.truth()
    tool: Transform = as_transform(truth.tracker_from_body_ref).inverse() @ as_transform(truth.tracker_from_coil)
    return float(tool.translation @ tool.rotation[:, 2])


async def test_a_daemon_is_guided_over_its_bus(tmp_path: Path) -> None:
    async with open_cell(tmp_path / "cell1", ("sim.seed=5", *PATIENT)) as cell:
        await to_standoff(cell.client)
        await by_the_command_line(cell, tmp_path)
        await beside_somebody_else(cell)
        await until_it_is_killed(cell, tmp_path)
        assert "Traceback" not in cell.log


async def by_the_command_line(cell: RunningCell, folder: Path) -> None:
    script = folder / "up.txt"
    script.write_text("0.0 0 0 0.01 0 0 0   # up\n1.0 0 0 0 0 0 0\n1.5 open\n2.0 open\n")
    before = await height(cell)
    process = await asyncio.create_subprocess_exec(*teleop_command(cell, script), stdout=asyncio.subprocess.PIPE)
    written, _ = await process.communicate()
    assert process.returncode == 0
    assert abs(await height(cell) - before - 0.010) < 0.003
    told = [json.loads(line) for line in written.splitlines()]
    assert any(each["user"] == "local" and (each["round_trip"] or 0.0) > 0.0 for each in told)
    shown = await cell.client.state()
    assert (shown.branches["placement"], shown.latched, shown.lease) == ("held", False, None)
    await to_standoff(cell.client)


async def beside_somebody_else(cell: RunningCell) -> None:
    async with (
        Client.connect(cell.ready.endpoint, cell.ready.prefix.split("/")[1], cell.name, user="alice") as alice,
        Client.connect(cell.ready.endpoint, cell.ready.prefix.split("/")[1], cell.name, user="eve") as eve,
    ):
        session = TeleopSession(
            alice, TwistScript([(0.0, (0.0,) * 6), (1.5, None)]), SystemClock(), 50.0, lambda _: None
        )
        before = await height(cell)
        guiding = asyncio.create_task(session.run())
        refused: dict[str, int] = {}
        number = 0
        while not guiding.done():
            number += 1
            if session.status is not None:
                eve.steer(TeleopSetpoint(sequence=number, sent=0.0, seen=session.status.stamp, ttl=1.0, twist=UP))
                refused = session.status.refused or refused
            await asyncio.sleep(0.02)
        assert await guiding == ""
        assert refused["other_user"] > 10
        assert abs(await height(cell) - before) < STILL
    await to_standoff(cell.client)


async def until_it_is_killed(cell: RunningCell, folder: Path) -> None:
    script = folder / "long.txt"
    script.write_text("0.0 0 0 0.002 0 0 0\n60.0 open\n")
    process = await asyncio.create_subprocess_exec(*teleop_command(cell, script), stdout=asyncio.subprocess.DEVNULL)
    try:
        await until(cell.client, showing(teleoperation="engaged"))
        await asyncio.sleep(0.5)
    finally:
        process.kill()
        await process.wait()
    held = await until(cell.client, lambda snapshot: snapshot.latched and showing(placement="held")(snapshot))
    assert held.branches["teleoperation"] == "off"
    assert "teleoperator_lost" in [row.operation for row in cell.rows()]
    before = await height(cell)
    assert (await cell.client.call("placement.guide")).decision == "rejected"
    await accept(cell.client, "robot.acknowledge")
    assert abs(await height(cell) - before) < STILL
    await accept(cell.client, "placement.back_off")
