"""Faults of a watched scene: a hand in the workspace, and a detector that cannot see, beside a running cell."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from pcmrs.messages import SceneEvent
from pcmrs.messages.scene_event import WATCHING
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import accept, to_retracted, until
from pcmrs_lab.campaign.checks import expect, held
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.experiment.scene_camera import WATCHED, SceneCamera, scene_camera

BEGUN = 1.0
"""Time for which an approach runs before the fault, s."""
RETURNED = 3.0
"""Time after which a source that sends again counts, s: more than its `returns_after`."""
FLOOD = 2000
"""Number of events at once: ten times the rate that a source may have."""

Harm = Callable[[RunningCell, SceneCamera], None]


async def approach_held(lab: Lab, code: str, why: str, begin: Harm, end: Harm) -> Evidence:
    """Check that an approach is held at a fault, that none begins until it is over, and that one is accepted then.

    Args:
        lab: Surroundings of the fault.
        code: Code of the danger event.
        why: Reason in it; empty for none.
        begin: Injects the fault.
        end: Ends it.

    Returns:
        Evidence of the row.
    """
    async with lab.cell(*REAL_TIME, *WATCHED) as cell, scene_camera(cell) as camera:
        await asyncio.sleep(RETURNED)
        await to_retracted(cell.client)
        row = cell.last_row()
        moving = asyncio.create_task(cell.client.call("placement.approach"))
        await until(cell.client, lambda shown: bool(shown.running))
        await asyncio.sleep(BEGUN)
        began = asyncio.get_running_loop().time()
        if not is_sham():
            begin(cell, camera)
        await held(cell)
        await moving
        fields = _danger(cell, row, code)
        expect(not why or fields.get("why") == why, f"The event says {fields.get('why')}, not {why}.")
        await accept(cell.client, "robot.acknowledge")
        await accept(cell.client, "placement.back_off")
        refused = await cell.client.call("placement.confirm")
        found = refused.reason.code if refused.reason is not None else refused.decision
        expect(found == "scene_not_clear", f"With the fault, the next motion was {found}.")
        took_place = _seen(camera, began)
        end(cell, camera)
        await asyncio.sleep(RETURNED)
        await accept(cell.client, "placement.home")
        control = await accept(cell.client, "placement.approach")
    return Evidence(
        f"held and latched ({code}), next motion refused until it is over",
        took_place=took_place,
        control_kind="without_fault",
        control={"approach without the fault": control.decision},
    )


def _danger(cell: RunningCell, after: int, code: str) -> dict[str, Any]:
    """Return the fields of the danger event in the journal."""
    rows = [row for row in cell.rows(after) if row.kind == "device" and row.operation == code]
    expect(bool(rows), f"The journal has no {code}.")
    return dict((rows[0].result or {}).get("fields", {}))


def _seen(camera: SceneCamera, began: float) -> dict[str, Any]:
    """Return what a subscriber of the bus has received since a time of the event loop, s."""
    received = [(at, event) for at, event in camera.events if at >= began]
    labels = sorted({event.reason or event.label for _, event in received} - {WATCHING})
    times = [began, *(at for at, event in received if event.label == WATCHING), asyncio.get_running_loop().time()]
    gap = max(after - before for before, after in pairwise(times))
    return {"other events": labels} if labels else {"longest time without a sign of life": gap}


@fault("S15", how="simulated depth camera: a hand enters the workspace during an approach", deadline=240.0)
async def hand_in_the_workspace(lab: Lab) -> Evidence:
    """The arm is held, and nothing approaches until the hand has left."""
    return await approach_held(
        lab,
        "scene_intrusion",
        "",
        lambda _, camera: camera.show_hand(),
        lambda _, camera: camera.tell("hand away"),
    )


@fault("S16", how="SIGSTOP of the detector's process during an approach", deadline=240.0)
async def detector_is_silent(lab: Lab) -> Evidence:
    """The arm is held, and nothing approaches until the detector sends again."""
    return await approach_held(
        lab,
        "scene_lost",
        "silent",
        lambda _, camera: camera.process.send_signal(signal.SIGSTOP),
        lambda _, camera: camera.process.send_signal(signal.SIGCONT),
    )


@fault("S17", how="simulated depth camera: it repeats its last image during an approach", deadline=240.0)
async def frozen_image(lab: Lab) -> Evidence:
    """The detector notices the number of the image, reports that it is blind, and the arm is held."""
    return await approach_held(
        lab,
        "scene_lost",
        "blind",
        lambda _, camera: camera.tell("freeze on"),
        lambda _, camera: camera.tell("freeze off"),
    )


@fault("S18", how="simulated depth camera: something right before its lens during an approach", deadline=240.0)
async def occluded_camera(lab: Lab) -> Evidence:
    """The detector reports that it is blind, and the arm is held."""
    return await approach_held(
        lab,
        "scene_lost",
        "blind",
        lambda _, camera: camera.tell("occlude on"),
        lambda _, camera: camera.tell("occlude off"),
    )


@fault("S19", how="simulated depth camera: it is pushed back by 0.5 m during an approach", deadline=240.0)
async def moved_camera(lab: Lab) -> Evidence:
    """The detector finds much of the scene behind its background, and the arm is held."""
    return await approach_held(
        lab,
        "scene_lost",
        "blind",
        lambda _, camera: camera.tell("move 0.5"),
        lambda _, camera: camera.tell("move 0"),
    )


@fault("S20", how="2000 scene events at once under the name of the source, during an approach", deadline=240.0)
async def flood_of_events(lab: Lab) -> Evidence:
    """The source counts as lost, and the arm is held; afterwards the source counts again."""
    return await approach_held(lab, "scene_lost", "flooded", _flood, lambda *_: None)


def _flood(cell: RunningCell, camera: SceneCamera) -> None:
    _, newest = camera.events[-1]
    for number in range(FLOOD):
        event = SceneEvent(
            source="camera",
            label=f"flood{number % 10}",
            captured=newest.captured,
            sent=newest.sent,
            session=newest.session,
        )
        cell.bus.publish("scene/local", event)
