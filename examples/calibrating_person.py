"""Simulate the person in `pcmrs calibrate pivot|hand-eye --live` on the simulated cell.

`sim.geometry` has the true poses of the tool; the simulation reports the true tip of the pointer.
"""

from __future__ import annotations

import asyncio
import itertools
import json
from pathlib import Path
from typing import Any

import click

from pcmrs.client import DEFAULT_ENDPOINT, Client
from pcmrs.spatial import Transform

PLAN = json.loads((Path(__file__).parent / "ratms_plan.json").read_text())
TURNS = (0.6, -0.6)
"""Turns of the planned poses about the tool's axis, rad: tilts alone would turn the arm too little about one axis."""
REST = 1.5
"""Pause in every posture, s."""


@click.command()
@click.argument("kind", type=click.Choice(["pivot", "hand-eye"]))
@click.option("--endpoint", default=DEFAULT_ENDPOINT, show_default=True)
@click.option("--site", default="lab", show_default=True)
@click.option("--cell", default="cell1", show_default=True)
def main(kind: str, endpoint: str, site: str, cell: str) -> None:
    """Pivot the pointer, or move the arm from posture to posture."""
    asyncio.run(act(kind, endpoint, site, cell))


async def act(kind: str, endpoint: str, site: str, cell: str) -> None:
    """Connect to the cell and run the motion of a calibration.

    Args:
        kind: ``pivot`` or ``hand-eye``.
        endpoint: Zenoh endpoint of the bus.
        site: Name of the site.
        cell: Name of the cell.
    """
    async with Client.connect(endpoint, site, cell) as client:
        await (pivot(client) if kind == "pivot" else change_postures(client))


async def pivot(client: Client) -> None:
    """Pivot the pointer about its tip for ten minutes of the cell."""
    await client.request_device("scene", "pivot_pointer", {"duration": 600.0})
    truth = await client.request_device("scene", "truth")
    x, y, z = (1000.0 * value for value in truth["tip_in_pointer"])
    click.echo(f"the tip is truly at {x:.3f} {y:.3f} {z:.3f} mm")


async def change_postures(client: Client) -> None:
    """Register the head, then move to the standoff of every planned pose, turned in both directions."""
    await call(client, "robot.connect")
    await call(client, "registration.plan_landmarks", landmarks=PLAN["landmarks"])
    await call(client, "digitization.digitize_all")
    await call(client, "registration.register")
    for pose, turn in itertools.product(PLAN["poses"], TURNS):
        await call(client, "toolplan.plan", **turned(pose, turn))
        await call(client, "placement.approach")
        await asyncio.sleep(REST)
        await call(client, "placement.home")


def turned(pose: dict[str, Any], angle: float) -> dict[str, Any]:
    """Return a planned pose, turned about the tool's axis.

    Args:
        pose: Planned pose, as in the plan's file.
        angle: Angle, rad.
    """
    planned = Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"])
    found = planned @ Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, angle))
    return pose | {"quat_xyzw": found.quat_xyzw.tolist()}


async def call(client: Client, name: str, **arguments: object) -> None:
    """Request an operation; continue if it is refused.

    Args:
        client: Client of the cell.
        name: Operation, ``branch.operation``.
        arguments: Arguments of the operation.
    """
    verdict = await client.call(name, arguments)
    if verdict.reason is not None:
        click.echo(f"{name} {verdict.decision}: {verdict.reason.text}", err=True)


if __name__ == "__main__":
    main()
