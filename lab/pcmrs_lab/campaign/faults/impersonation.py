"""An account on the cell's machine sends messages in the name of the daemon or of a device, past the workflow."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

import msgspec

from pcmrs.bus import Bus, BusSettings
from pcmrs.errors import DeviceError
from pcmrs.messages import (
    ActToken,
    Beat,
    BodyPose,
    DeviceEvent,
    DeviceReply,
    DeviceRequest,
    JointState,
    NodeBeat,
)
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.driving import PATIENCE, accept, moving, register, to_retracted, until, wait_until_stationary
from pcmrs_lab.campaign.checks import expect, standing
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.waiting import until_true

FORGED = 20
"""Number of messages of each kind."""
FAR_AHEAD = 1e12
"""Time stamp that would make all other messages late, s."""
FORGED_EVENT = DeviceEvent(device="robot", code="link_lost", text="forged", danger=True)


@asynccontextmanager
async def stranger(cell: RunningCell) -> AsyncIterator[Bus]:
    """Open a bus client on this machine without the key of daemon and nodes."""
    bus = await Bus.open(BusSettings(endpoint=cell.ready.endpoint, cell=cell.name))
    try:
        yield bus
    finally:
        await bus.close()


@fault("A27", how="requests to device nodes from a bus client without the key of daemon and nodes")
async def requests_past_the_daemon(lab: Lab) -> Evidence:
    """Every method is refused before the device receives it; the same request with the key is served."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        arm = await cell.client.request_device("robot", "joints")
        away = {
            "trajectory": {"period": 1.0, "positions": [arm["positions"], [each + 0.1 for each in arm["positions"]]]}
        }
        token = ActToken(daemon="d", node="n", epoch=0, number=1)
        asked: list[tuple[str, DeviceRequest]] = [
            ("robot", DeviceRequest(method="follow", arguments=away, token=token)),
            ("robot", DeviceRequest(method="release_latch", token=token)),
            ("robot", DeviceRequest(method="joints")),
            ("stimulator", DeviceRequest(method="arm", token=token)),
            ("pointer", DeviceRequest(method="touch_surface", token=token)),
        ]
        async with stranger(cell) as bus, standing(cell) as moved:
            forged = [] if is_sham() else asked
            answers = {f"{device}.{request.method}": await _answer(bus, device, request) for device, request in forged}
        expect(set(answers.values()) == {"not_sealed"}, f"Requests without the key were answered: {answers}.")
        control = await cell.bus.request("dev/robot/cmd", DeviceRequest(method="joints"), DeviceReply, PATIENCE)
        expect(control.failure is None, "The same request with the key is refused, too.")
    return Evidence(
        "not_sealed",
        took_place={"answered_by_the_nodes": answers},
        control_kind="permitted",
        control={"joints_with_the_key": control.result},
        details={"moved_rad": moved[0]},
    )


async def _answer(bus: Bus, device: str, request: DeviceRequest) -> str:
    try:
        reply = await bus.request(f"dev/{device}/cmd", request, DeviceReply, PATIENCE)
    except DeviceError as error:
        return str(error.fields.get("reason", error.code))
    return "served" if reply.failure is None else reply.failure.code


@fault("A27", how="beats, poses, joints and events put by a bus client without the key, during a motion")
async def messages_in_a_devices_name(lab: Lab) -> Evidence:
    """No forged message is accepted: the motion ends as usual, nothing is latched, and each is counted."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        before = await _unsealed_count(cell)
        async with stranger(cell) as bus:
            async with moving(cell.client) as verdict:
                sent = _forge(bus)
            result = verdict.result()
            shown = await cell.client.state()
            expect(result.decision == "accepted", f"The motion ended as {result.decision}: {result.reason}.")
            expect(not shown.latched, "Forged messages have latched Stop.")

            counted = await _unsealed_count(cell) - before
            expect(counted >= FORGED, f"Of {sent} forged messages the daemon counted {counted}.")
        await accept(cell.client, "placement.home")
        cell.bus.publish("dev/robot/event", FORGED_EVENT)
        latched = (await until(cell.client, lambda shown: shown.latched)).latched
        await wait_until_stationary(cell.client)
    return Evidence(
        "dropped and counted",
        took_place={"counted": counted},
        control_kind="permitted",
        control={"motion": result.decision, "the_event_with_the_key_latches": latched},
        details={"forged": sent},
    )


def _forge(bus: Bus) -> int:
    """Put messages in the name of daemon and devices; return how many."""
    joints = JointState(
        captured=0.0, sent=FAR_AHEAD, positions=[0.0] * 7, velocities=[0.0] * 7, torques=[0.0] * 7, moving=False
    )
    pose = BodyPose(body="coil", frame_number=10**6, captured=FAR_AHEAD, sent=FAR_AHEAD, valid=False)
    forged: dict[str, msgspec.Struct] = {
        "dev/robot/beat": NodeBeat(number=10**6, sent=FAR_AHEAD),
        "dev/robot/event": FORGED_EVENT,
        "state/joints": joints,
        "state/pose/coil": pose,
        "daemon/beat": Beat(number=10**6, session="forged", alive=FAR_AHEAD, sent=FAR_AHEAD),
    }
    for _ in range(FORGED):
        for key, message in forged.items():
            inject_unless_sham(partial(bus.publish, key, message))
    return FORGED * len(forged)


async def _unsealed_count(cell: RunningCell) -> int:
    return (await cell.client.health()).dropped["bus.not_sealed"]


@fault("A28", how="an event on a device's key, sealed like a device's node, in the name of the lease or the daemon")
async def event_of_another_device(lab: Lab) -> Evidence:
    """The event is dropped and counted; the same event in the device's own name is accepted."""
    async with lab.cell() as cell:
        await register(cell.client)
        row, before = cell.last_row(), await _misnamed_count(cell)
        for device in ("lease", "daemon", "robot", "no_such_device"):
            inject_unless_sham(partial(cell.bus.publish, "dev/tracker/event", _event(device)))
        cell.bus.publish("dev/tracker/event", _event("tracker"))

        def reported() -> bool:
            return _reported(cell, row) != []

        await until_true(reported, "The control, an event in the device's own name, was not accepted")
        misnamed = await _misnamed_count(cell) - before
        expect(misnamed == 4, f"Of 4 events in the name of another device {misnamed} were counted.")
        expect(_reported(cell, row) == ["tracker"], f"Events were accepted of {_reported(cell, row)}.")
        journalled = _reported(cell, row)
    return Evidence(
        "dropped and counted",
        took_place={"misnamed": misnamed},
        control_kind="permitted",
        control={"journalled_in_its_own_name": journalled},
    )


def _event(device: str) -> DeviceEvent:
    return DeviceEvent(device=device, code="impersonated", text="An event that a fault has put.")


def _reported(cell: RunningCell, row: int) -> list[str | None]:
    """Return the sources of such events in the journal."""
    return [each.source for each in cell.rows(row) if (each.kind, each.operation) == ("device", "impersonated")]


async def _misnamed_count(cell: RunningCell) -> int:
    return (await cell.client.health()).dropped.get("events.misnamed", 0)
