"""Faults of the bus: a proxy stands between node and daemon, the router ends, or a consumer is too slow."""

from __future__ import annotations

import asyncio
import signal

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import BodyPose, Snapshot
from pcmrs.testing.arm import stands
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import PATIENCE, accept, moving, register, reset_cell, tool_pose, until
from pcmrs_lab.campaign.checks import expect, held, refused
from pcmrs_lab.campaign.consumer import Manner, consumer
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.sham import inject_unless_sham
from pcmrs_lab.campaign.waiting import until_ended, until_true
from pcmrs_lab.campaign.wire import remote_cell

WIRE = "userspace proxy between device node and daemon, TCP"
NARROW = 100_000 / 8
"""100 kbit/s, in bytes per second."""

SLOW = 2.0
"""Time for which a consumer reads nothing before a command is sent, s of the machine."""

LISTENED = 2.0
"""Time for which poses that come over a link are counted, s of the machine."""

BURST = 10
"""Number of poses that may come between the two counts, of received and of dropped ones."""


@fault("N9", how=f"{WIRE}; nothing arrives at the node")
async def the_daemon_does_not_reach_the_robot(lab: Lab) -> Evidence:
    """In motion, messages from the daemon to the node are lost: the node holds the arm by itself."""
    return await _cut_in_motion(lab, towards=True, back=False)


@fault("N9", how=f"{WIRE}; nothing arrives at the daemon")
async def the_robot_does_not_reach_the_daemon(lab: Lab) -> Evidence:
    """In motion, messages from the node to the daemon are lost."""
    return await _cut_in_motion(lab, towards=False, back=True)


@fault(
    "N10",
    how="SIGKILL of the daemon, whose router all others are clients of, and another one in its place",
    deadline=300.0,
)
async def the_router_is_restarted(lab: Lab) -> Evidence:
    """A client that stays connected does not subscribe again, and receives the new daemon's messages."""
    endpoint = f"cell.endpoint=tcp/127.0.0.1:{free_port()}"
    place = lab.folder / "cell"
    received: list[Snapshot] = []
    async with lab.daemon(endpoint, folder=place) as first:
        first.client.listen("state/fsm", Snapshot, received.append)
        await accept(first.client, "registration.reinit")
        await until_true(lambda: bool(received), "No snapshot of the first daemon came")
        before = len(received)
        inject_unless_sham(lambda: first.process.send_signal(signal.SIGKILL))
        status = await until_ended(first)
        received.clear()
        async with lab.daemon(endpoint, folder=place) as second:
            await accept(second.client, "robot.connect")
            await until_true(
                lambda: any(shown.branches["robot"] == "1" for shown in received), "No snapshot of the new daemon came"
            )
            verdict = await first.client.call("registration.reinit", timeout=PATIENCE)
            expect(verdict.decision == "accepted", f"Over the old connection it was {verdict.decision}.")
            rows = second.rows()
    expect(any(row.kind == "outcome" for row in rows), "The journal is empty.")
    return Evidence(
        "subscriptions and requests work again",
        {"snapshots": len(received)},
        took_place={"exit_status_of_the_first": status},
        control_kind="without_fault",
        control={"snapshots_of_the_first": before},
    )


@fault("N11", how="a subscriber to a stream, whose event loop is busy with something else")
async def a_consumer_that_has_no_time(lab: Lab) -> Evidence:
    """Messages that it does not read are counted as dropped by its bus; commands and Stop are as quick as before."""
    return await _with_slow_consumer(lab, "busy")


@fault("N11", how="a subscriber to a stream, frozen by SIGSTOP")
async def a_consumer_that_does_not_read(lab: Lab) -> Evidence:
    """Messages lost at its full socket show only in the frame numbers; control is unaffected."""
    return await _with_slow_consumer(lab, "frozen")


@fault("N12", how=WIRE)
async def a_wire_of_100_kbit(lab: Lab) -> Evidence:
    """Poses are too old when they arrive: operations that need them are refused for that; status and Stop work."""
    impairment = InjectedImpairment(seed=lab.seed)
    async with remote_cell(lab, impairment) as cell:
        await register(cell.client)
        control = await accept(cell.client, "placement.approach")
        await accept(cell.client, "placement.home")
        usual = await _poses(cell)
        impairment.rate = NARROW
        await asyncio.sleep(4.0)
        narrow = await _poses(cell)
        approach = await refused(cell, "placement.approach", codes=("pose_stale",))
        await cell.client.stop()
        snapshot = await until(cell.client, lambda shown: shown.latched)
        impairment.rate = None
        await stands(cell)
    text = approach.reason.text if approach.reason is not None else ""
    return Evidence(
        "refused; Stop and status work",
        {"approach": text, "sequence": snapshot.sequence},
        took_place={"poses_fewer": max(0, usual - narrow)},
        control_kind="without_fault",
        control={"approach": control.decision, "reached": control.state, "poses": usual},
    )


async def _poses(cell: RunningCell) -> int:
    """Return the number of poses that reach the daemon's side of the link within `LISTENED`."""
    received: list[int] = []
    end = cell.client.listen("state/pose/coil", BodyPose, lambda pose: received.append(pose.frame_number))
    await asyncio.sleep(LISTENED)
    await end()
    return len(received)


@fault("N13", how=WIRE)
async def a_half_open_link(lab: Lab) -> Evidence:
    """Messages are lost in both directions, and no side closes the connection."""
    return await _cut_in_motion(lab, towards=False, back=False)


async def _cut_in_motion(lab: Lab, *, towards: bool, back: bool) -> Evidence:
    """Cut the link between node and daemon while the arm moves; `towards` is from node to daemon."""
    impairment = InjectedImpairment(seed=lab.seed)
    async with remote_cell(lab, impairment) as cell:
        await register(cell.client)
        clock = asyncio.get_running_loop().time
        async with moving(cell.client) as verdict:
            impairment.towards, impairment.back = towards, back
            cut = clock()
            shown = await until(cell.client, lambda snapshot: snapshot.latched or snapshot.branches["robot"] == "0")
            found = clock() - cut
            await asyncio.sleep(1.0)
            silent = max((device.heard or 0.0) for device in (await cell.client.health()).devices)
            impairment.towards, impairment.back = True, True
            ended = await verdict
        expect(ended.decision != "accepted", "The approach was accepted though the wire was cut.")
        expect(ended.state in ("held", "unknown"), f"The tool counts as {ended.state}.")
        displacement = await _check_stands_when_back(cell)
        await held(cell, ("held", "unknown"))
        await reset_cell(cell.client)
        await register(cell.client)
        control = await accept(cell.client, "placement.approach")
        log = (lab.folder / "remote" / "node.log").read_text(errors="replace")
        by_node = "held_by_node" in log
        expect(back or by_node, "The node did not hold the arm by itself.")
        expect(towards or silent >= 1.0, f"The node was silent for {silent:.2f} s only.")
    return Evidence(
        f"held, {ended.state}; nothing moved when the wire was back",
        took_place=({} if back else {"held_by_node": by_node}) | ({} if towards else {"silent_s": round(silent, 3)}),
        control_kind="without_fault",
        control={"approach": control.decision, "reached": control.state},
        details={"found_after_s": round(found, 3), "latched": shown.latched, "way_m": displacement},
    )


async def _check_stands_when_back(cell: RunningCell) -> float:
    """Check that the arm stands as soon as its node can be reached again."""
    async with asyncio.timeout(PATIENCE):
        while True:
            try:
                await cell.scene.truth()
            except UnknownOutcomeError:
                await asyncio.sleep(0.1)
            else:
                return await stands(cell)


async def _with_slow_consumer(lab: Lab, manner: Manner) -> Evidence:
    frozen = manner == "frozen"
    async with lab.cell() as cell:
        await register(cell.client)
        async with consumer(cell, "idle") as resume:
            usual = await _slowest_command(cell)
            idle = await resume()
        async with consumer(cell, manner) as resume:
            await asyncio.sleep(SLOW)
            beside = await _slowest_command(cell)
            async with moving(cell.client):
                await cell.client.stop()
            await held(cell)
            poses = await resume()
        await reset_cell(cell.client)
    expect(beside < 1.0, f"A command took {beside:.2f} s beside a consumer that is too slow.")
    expect(poses.lost > BURST, f"The consumer was not too slow: it lost {poses.lost} of {poses.sent} poses.")
    expect(
        frozen or abs(poses.lost - poses.counted) <= BURST,
        f"The consumer lost {poses.lost} of {poses.sent} poses, and its bus counted {poses.counted}.",
    )
    expect(not frozen or poses.was == "T", f"The consumer was not frozen: its process was {poses.was}.")
    expect(idle.lost < poses.lost, f"A consumer that has time lost {idle.lost} of {idle.sent} poses.")
    return Evidence(
        "control unaffected" if frozen else "drops counted, control unaffected",
        {"beside_s": beside, "sent": poses.sent, "state": poses.was},
        took_place={"lost": poses.lost} if frozen else {"lost": poses.lost, "counted": poses.counted},
        control_kind="without_fault",
        control={"heard_by_one_that_has_time": idle.received, "command_beside_it_s": usual},
    )


async def _slowest_command(cell: RunningCell) -> float:
    """Return the time of the slowest of some commands, s."""
    clock = asyncio.get_running_loop().time
    taken = []
    for _ in range(20):
        started = clock()
        await accept(cell.client, "toolplan.plan", **tool_pose())
        taken.append(clock() - started)
    return round(max(taken), 4)
