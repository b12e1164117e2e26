"""An account on the cell's machine, or a device, sends messages in the name of the daemon or of another device."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial

import msgspec

from pcmrs.bus import Bus, BusSettings
from pcmrs.bus.seal import Seal
from pcmrs.bus.serving import attached_to, payload_of
from pcmrs.bus.settings import open_session
from pcmrs.devices.gate import ACTS
from pcmrs.errors import DeviceError
from pcmrs.messages import (
    ActToken,
    Beat,
    BodyPose,
    DeviceEvent,
    DeviceHealth,
    DeviceReply,
    DeviceRequest,
    GateState,
    JointState,
    NodeBeat,
)
from pcmrs.testing.arm import NO_MOTION, displaced, standing
from pcmrs.testing.cell import REAL_TIME, RunningCell
from pcmrs.testing.daemon import device_key
from pcmrs.testing.driving import PATIENCE, accept, moving, to_retracted, until, wait_until_stationary
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.faults.access import TLS
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.reachable import DEVICE, ReachableCell, reachable_cell
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.tries import DELAYED, DEVICES, LOCAL_ACCOUNT, STREAMS, record
from pcmrs_lab.campaign.waiting import until_true

FORGED = 20
"""Number of messages of each kind."""
FAR_AHEAD = 1e12
"""Time stamp that would make all other messages late, s."""
FORGED_EVENT = DeviceEvent(device="robot", code="link_lost", text="forged", danger=True)
FIRST_NUMBER = 10**6
"""Number of a request that is greater than those of the daemon, which counts from 1."""
TURN = 0.2
"""Time between two messages of the same kind, of which at least one must arrive, s of the machine."""
IMPLAUSIBLE = 3
"""Number of sealed heartbeats with a wrong time stamp; ten that agree would count as the daemon's new clock."""


@asynccontextmanager
async def stranger(cell: RunningCell) -> AsyncIterator[Bus]:
    """Open a bus client on this machine without the key of daemon and nodes."""
    bus = await Bus.open(BusSettings(endpoint=cell.ready.endpoint, cell=cell.name))
    try:
        yield bus
    finally:
        await bus.close()


@fault(
    "A27",
    how="requests to device nodes with valid tokens while Stop is latched, without the key of daemon and nodes",
    deadline=180.0,
    tries={LOCAL_ACCOUNT: [DEVICES]},
)
async def requests_past_the_daemon(lab: Lab) -> Evidence:
    """Each is refused before the device receives it; with the key the same requests end the latch and move the arm."""
    async with lab.daemon(*REAL_TIME) as cell:
        await to_retracted(cell.client)
        await cell.client.stop()
        await until(cell.client, lambda shown: shown.latched and shown.stop.confirmed)
        arm = await cell.client.request_device("robot", "joints")
        async with stranger(cell) as bus:
            gates = await _gates(bus)
            async with standing(cell) as moved:
                forged = [] if is_sham() else _valid_requests(gates, arm["positions"])
                answers = {f"{device}.{each.method}": await _answer(bus, device, each) for device, each in forged}
                record(LOCAL_ACCOUNT, DEVICES)
        expect(set(answers.values()) == {"not_sealed"}, f"Requests without the key were answered: {answers}.")
        expect((await cell.client.state()).latched, "Stop is not latched any more.")
        async with displaced(cell) as moved_with_key:
            requests = [each for each in _valid_requests(gates, arm["positions"]) if each[0] == "robot"]
            with_key = {request.method: await _answer(cell.bus, device, request) for device, request in requests}
        expect(moved_with_key[0] > NO_MOTION, f"With the key, too, the arm has not moved: {with_key}.")
    return Evidence(
        "not_sealed",
        took_place={"answered_by_the_nodes": answers},
        control_kind="permitted",
        control={"moved_by_the_same_requests_with_the_key_rad": moved_with_key[0]},
        details={"moved_rad": moved[0], "with_the_key": with_key},
    )


async def _gates(bus: Bus) -> dict[str, GateState]:
    """Return the state of each gate, as anybody on the machine can read it from the nodes' heartbeats."""
    gates: dict[str, GateState] = {}

    def take(key: str, beat: NodeBeat) -> None:
        if beat.gate is not None:
            gates[key.split("/")[1]] = beat.gate

    end = bus.subscribe("dev/*/beat", NodeBeat, take)
    await until_true(lambda: gates.keys() == ACTS.keys(), "Not every gate has sent a heartbeat")
    await end()
    return gates


def _valid_requests(gates: dict[str, GateState], positions: list[float]) -> list[tuple[str, DeviceRequest]]:
    """Return requests that name the present sessions and epoch of each gate: the gates would admit them.

    Args:
        gates: State of each gate.
        positions: Present joint positions, rad.
    """

    def token(device: str, number: int) -> ActToken:
        gate = gates[device]
        return ActToken(daemon=gate.daemon, node=gate.node, epoch=gate.epoch, number=FIRST_NUMBER + number)

    away = {"trajectory": {"period": 1.0, "positions": [positions, [each + 0.05 for each in positions]]}}
    return [
        ("robot", DeviceRequest(method="joints")),
        ("robot", DeviceRequest(method="release_latch", token=token("robot", 1))),
        ("robot", DeviceRequest(method="follow", arguments=away, token=token("robot", 2))),
        ("stimulator", DeviceRequest(method="release_latch", token=token("stimulator", 1))),
        ("stimulator", DeviceRequest(method="arm", token=token("stimulator", 2))),
        ("pointer", DeviceRequest(method="touch_surface", token=token("pointer", 1))),
    ]


async def _answer(bus: Bus, device: str, request: DeviceRequest) -> str:
    try:
        reply = await bus.request(f"dev/{device}/cmd", request, DeviceReply, PATIENCE)
    except DeviceError as error:
        return str(error.fields.get("reason", error.code))
    return "served" if reply.failure is None else reply.failure.code


@fault(
    "A27",
    how="beats, poses, joints and events put without the key, and sealed ones put again, during a motion",
    tries={LOCAL_ACCOUNT: [DEVICES, STREAMS], DELAYED: [DEVICES, STREAMS]},
)
async def messages_in_a_devices_name(lab: Lab) -> Evidence:
    """No forged message is accepted: the motion ends as usual, nothing is latched, and each is counted."""
    async with lab.cell(*REAL_TIME, fresh=False) as cell:
        await to_retracted(cell.client)
        before = await _unsealed_count(cell)
        async with stranger(cell) as bus:
            async with moving(cell.client) as verdict:
                sent = _forge(bus)
                counted = await _counted(cell, before, FORGED)
                replayed = await asyncio.to_thread(_replay, cell)
                counted_again = await _counted(cell, before + counted, FORGED)
            result = verdict.result()
            shown = await cell.client.state()
            expect(result.decision == "accepted", f"The motion ended as {result.decision}: {result.reason}.")
            expect(not shown.latched, "Forged messages have latched Stop.")
        await accept(cell.client, "placement.home")
        cell.bus.publish("dev/robot/event", FORGED_EVENT)
        shown = await until(cell.client, lambda shown: shown.latched and shown.branches["robot"] == "0")
        await wait_until_stationary(cell.client)
    return Evidence(
        "dropped and counted",
        took_place={"counted": counted, "counted_of_repeated_ones": counted_again},
        control_kind="permitted",
        control={"motion": result.decision, "the_event_with_the_key_latches": shown.latched},
        details={"forged": sent, "repeated": replayed},
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
    record(LOCAL_ACCOUNT, DEVICES, STREAMS)
    return FORGED * len(forged)


def _replay(cell: RunningCell) -> int:
    """Put sealed beats and joints of the robot's node once more, as they were received; return how many."""
    received: list[tuple[str, bytes, bytes]] = []
    with open_session(BusSettings(endpoint=cell.ready.endpoint, cell=cell.name)) as session:
        for key in ("dev/robot/beat", "state/joints"):
            session.declare_subscriber(
                f"{cell.ready.prefix}/{key}",
                lambda sample: received.append((str(sample.key_expr), payload_of(sample), attached_to(sample))),
            )
        limit = time.monotonic() + PATIENCE
        while len({key for key, _, _ in received}) < 2 or len(received) < FORGED:
            expect(time.monotonic() < limit, f"Of the robot's node only {len(received)} messages were received.")
            time.sleep(TURN)
        repeated = list(received)
        for key, payload, seal in repeated:
            inject_unless_sham(partial(session.put, key, payload, attachment=seal))
    record(DELAYED, DEVICES, STREAMS)
    return len(repeated)


async def _counted(cell: RunningCell, before: int, least: int) -> int:
    """Wait until the daemon has dropped all messages without a valid seal that are on their way; return the number.

    Args:
        cell: Cell that receives them.
        before: Number that it had dropped before.
        least: Least number that it must have dropped since.

    Raises:
        Unmet: It has dropped fewer within `PATIENCE`.
    """
    clock = asyncio.get_running_loop().time
    limit, last, counted = clock() + PATIENCE, -1, 0
    while counted < least or counted != last:
        expect(clock() < limit, f"Of the forged messages the daemon counted {counted}.")
        await asyncio.sleep(TURN)
        last, counted = counted, await _unsealed_count(cell) - before
    return counted


async def _unsealed_count(cell: RunningCell) -> int:
    return (await cell.client.health()).dropped["bus.not_sealed"]


@asynccontextmanager
async def device_session(open_cell: ReachableCell) -> AsyncIterator[Bus]:
    """Open a bus client on another machine with a device's certificate and the key of daemon and nodes."""
    bus = await Bus.open(open_cell.settings(DEVICE), Seal(device_key(open_cell.cell.folder)))
    try:
        yield bus
    finally:
        await bus.close()


@fault(
    "A28",
    how=f"{TLS}: events with a device's certificate and the key of daemon and nodes, in the name of others",
    tries={"device": [DEVICES]},
)
async def event_of_another_device(lab: Lab) -> Evidence:
    """The event is dropped and counted; the same event in the device's own name is accepted."""
    async with reachable_cell(lab) as open_cell, device_session(open_cell) as bus:
        cell = open_cell.cell
        row, before = cell.last_row(), await _misnamed_count(cell)
        while not _reported(cell, row):  # the first ones are lost until the link knows the daemon's interest
            bus.publish("dev/tracker/event", _event("tracker"))
            await asyncio.sleep(TURN)
        for device in ("lease", "daemon", "robot", "no_such_device"):
            inject_unless_sham(partial(bus.publish, "dev/tracker/event", _event(device)))
        record("device", DEVICES)
        reported = len(_reported(cell, row))
        bus.publish("dev/tracker/event", _event("tracker"))
        await until_true(lambda: len(_reported(cell, row)) > reported, "The last event was not accepted")
        misnamed = await _misnamed_count(cell) - before
        expect(misnamed == 4, f"Of 4 events in the name of another device {misnamed} were counted.")
        journalled = sorted(set(_reported(cell, row)))
        expect(journalled == ["tracker"], f"Events were accepted of {journalled}.")
    return Evidence(
        "dropped and counted",
        took_place={"misnamed": misnamed},
        control_kind="permitted",
        control={"journalled_in_its_own_name": journalled},
    )


@fault(
    "A28",
    how=f"{TLS}: heartbeats of the daemon with a time stamp far ahead, with the key of daemon and nodes",
    deadline=180.0,
    tries={"device": [DEVICES], LOCAL_ACCOUNT: [DEVICES]},
)
async def implausible_heartbeat(lab: Lab) -> Evidence:
    """A device's certificate may not put it; on the cell's machine it is counted and ignored, and the arm moves."""
    beats: list[Beat] = []
    health: list[DeviceHealth] = []
    async with reachable_cell(lab) as open_cell, device_session(open_cell) as bus, AsyncExitStack() as stack:
        cell = open_cell.cell
        stack.push_async_callback(cell.client.listen("daemon/beat", Beat, beats.append))
        stack.push_async_callback(cell.client.listen("dev/robot/state", DeviceHealth, health.append))
        async with cell.client.holding():
            await to_retracted(cell.client)
            await until_true(lambda: bool(beats and health), "No beats, or no health of the robot")
            for _ in range(IMPLAUSIBLE):
                inject_unless_sham(partial(bus.publish, "daemon/beat", _ahead(beats[-1])))
                await asyncio.sleep(TURN)
            record("device", DEVICES)
            health.clear()
            await until_true(lambda: len(health) > 1, "The robot's node has not reported its health")
            expect(_implausible(health[-1]) == 0, "A heartbeat with a device's certificate has reached the node.")
            for _ in range(IMPLAUSIBLE):
                inject_unless_sham(partial(cell.bus.publish, "daemon/beat", _ahead(beats[-1])))
                await asyncio.sleep(TURN)
            record(LOCAL_ACCOUNT, DEVICES)
            await until_true(lambda: _implausible(health[-1]) > 0, "The node has counted no implausible heartbeat")
            counted = _implausible(health[-1])
            motion = await accept(cell.client, "placement.home")
            expect(not (await cell.client.state()).latched, "An implausible heartbeat has latched Stop.")
    return Evidence(
        "denied, or counted and ignored",
        took_place={"implausible_at_the_node": counted},
        control_kind="permitted",
        control={"motion": motion.decision, "heartbeats_of_the_daemon": len(beats)},
    )


def _ahead(beat: Beat) -> Beat:
    """Return a heartbeat of the same session that follows, with a time stamp far ahead."""
    return msgspec.structs.replace(beat, number=beat.number + 1, alive=FAR_AHEAD, sent=FAR_AHEAD)


def _implausible(health: DeviceHealth) -> int:
    return health.dropped.get("implausible_beats", 0)


def _event(device: str) -> DeviceEvent:
    return DeviceEvent(device=device, code="impersonated", text="An event that a fault has put.")


def _reported(cell: RunningCell, row: int) -> list[str]:
    """Return the sources of such events in the journal."""
    return [each.source or "" for each in cell.rows(row) if (each.kind, each.operation) == ("device", "impersonated")]


async def _misnamed_count(cell: RunningCell) -> int:
    return (await cell.client.health()).dropped.get("events.misnamed", 0)
