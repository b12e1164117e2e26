"""Faults of the bus: a proxy stands between node and daemon, the router ends, or a consumer is too slow."""

from __future__ import annotations

import asyncio
import signal

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import BodyPose, Snapshot
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.daemon import free_port
from pcmrs.testing.driving import PATIENCE, accept, moving, register, reset_cell, tool_pose, until
from pcmrs_lab.campaign.checks import expect, held, refused, stands
from pcmrs_lab.campaign.consumer import Manner, consumer
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.network_impairment import NetworkImpairment
from pcmrs_lab.campaign.sham import bring_about
from pcmrs_lab.campaign.waiting import until_ended, until_true
from pcmrs_lab.campaign.wire import remote_cell

WIRE = "userspace proxy between device node and daemon, TCP"
NARROW = 100_000 / 8
"""100 kbit/s, in bytes per second."""

SLOW = 2.0
"""A consumer takes nothing for so long before anything is asked for, s of the machine."""

LISTENED = 2.0
"""Poses that come over a wire are counted for so long, s of the machine."""

BURST = 10
"""Poses that may come between a look at what was heard and one at what was counted."""


@fault("N9", how=WIRE)
async def the_daemon_does_not_reach_the_robot(lab: Lab) -> Evidence:
    """In motion, nothing gets from the daemon to the node any more: the node holds the arm by itself."""
    return await _cut_in_motion(lab, towards=True, back=False)


@fault("N9", how=WIRE)
async def the_robot_does_not_reach_the_daemon(lab: Lab) -> Evidence:
    """In motion, nothing gets from the node to the daemon any more."""
    return await _cut_in_motion(lab, towards=False, back=True)


@fault(
    "N10",
    how="SIGKILL of the daemon, whose router all others are clients of, and another one in its place",
    deadline=300.0,
)
async def the_router_is_restarted(lab: Lab) -> Evidence:
    """A client that stays subscribes to nothing anew, and hears the new daemon."""
    endpoint = f"cell.endpoint=tcp/127.0.0.1:{free_port()}"
    place = lab.folder / "cell"
    heard: list[Snapshot] = []
    async with lab.daemon(endpoint, folder=place) as first:
        first.client.listen("state/fsm", Snapshot, heard.append)
        await accept(first.client, "registration.reinit")
        await until_true(lambda: bool(heard), "No snapshot of the first daemon came")
        before = len(heard)
        bring_about(lambda: first.process.send_signal(signal.SIGKILL))
        status = await until_ended(first)
        heard.clear()
        async with lab.daemon(endpoint, folder=place) as second:
            await accept(second.client, "robot.connect")
            await until_true(
                lambda: any(shown.branches["robot"] == "1" for shown in heard), "No snapshot of the new daemon came"
            )
            verdict = await first.client.call("registration.reinit", timeout=PATIENCE)
            expect(verdict.decision == "accepted", f"Over the old connection it was {verdict.decision}.")
            rows = second.rows()
    expect(any(row.kind == "outcome" for row in rows), "The journal is empty.")
    return Evidence(
        "subscriptions and requests work again",
        {"snapshots": len(heard)},
        took_place={"exit_status_of_the_first": status},
        control={"snapshots_of_the_first": before},
    )


@fault("N11", how="a subscriber to a stream, whose event loop is busy with something else")
async def a_consumer_that_has_no_time(lab: Lab) -> Evidence:
    """Whatever it does not hear is counted as dropped by its bus; commands and Stop are as quick as before."""
    return await _beside_a_slow_consumer(lab, "busy")


@fault("N11", how="a subscriber to a stream, frozen by SIGSTOP")
async def a_consumer_that_does_not_read(lab: Lab) -> Evidence:
    """What its full socket keeps from it nobody can count but by the frames' numbers; control is unaffected."""
    return await _beside_a_slow_consumer(lab, "frozen")


@fault("N12", how=WIRE)
async def a_wire_of_100_kbit(lab: Lab) -> Evidence:
    """Poses come too late to be believed: what needs them is refused for that; status and Stop work."""
    weather = NetworkImpairment(seed=lab.seed)
    async with remote_cell(lab, weather) as cell:
        await register(cell.client)
        control = await accept(cell.client, "placement.approach")
        await accept(cell.client, "placement.home")
        usual = await _poses(cell)
        weather.rate = NARROW
        await asyncio.sleep(4.0)
        narrow = await _poses(cell)
        approach = await refused(cell, "placement.approach", codes=("pose_stale",))
        await cell.client.stop()
        snapshot = await until(cell.client, lambda shown: shown.latched)
        weather.rate = None
        await stands(cell)
    text = approach.reason.text if approach.reason is not None else ""
    return Evidence(
        "refused; Stop and status work",
        {"approach": text, "sequence": snapshot.sequence},
        took_place={"poses_fewer": max(0, usual - narrow)},
        control={"approach": control.decision, "reached": control.state, "poses": usual},
    )


async def _poses(cell: RunningCell) -> int:
    """How many poses reach the daemon's side of the wire within `LISTENED`."""
    heard: list[int] = []
    end = cell.client.listen("state/pose/coil", BodyPose, lambda pose: heard.append(pose.frame_number))
    await asyncio.sleep(LISTENED)
    await end()
    return len(heard)


@fault("N13", how=WIRE)
async def a_half_open_link(lab: Lab) -> Evidence:
    """Nothing gets through in either direction, and nobody closes anything."""
    return await _cut_in_motion(lab, towards=False, back=False)


async def _cut_in_motion(lab: Lab, *, towards: bool, back: bool) -> Evidence:
    """Cuts the wire between node and daemon while the arm moves; `towards` is from node to daemon."""
    weather = NetworkImpairment(seed=lab.seed)
    async with remote_cell(lab, weather) as cell:
        await register(cell.client)
        clock = asyncio.get_running_loop().time
        async with moving(cell.client) as verdict:
            weather.towards, weather.back = towards, back
            cut = clock()
            shown = await until(cell.client, lambda snapshot: snapshot.latched or snapshot.branches["robot"] == "0")
            found = clock() - cut
            await asyncio.sleep(1.0)
            silent = max((device.heard or 0.0) for device in (await cell.client.health()).devices)
            weather.towards, weather.back = True, True
            ended = await verdict
        expect(ended.decision != "accepted", "The approach was accepted though the wire was cut.")
        expect(ended.state in ("held", "unknown"), f"The tool counts as {ended.state}.")
        way = await _stands_when_back(cell)
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
        control={"approach": control.decision, "reached": control.state},
        details={"found_after_s": round(found, 3), "latched": shown.latched, "way_m": way},
    )


async def _stands_when_back(cell: RunningCell) -> float:
    """The arm stands, asked as soon as its node can be reached again."""
    async with asyncio.timeout(PATIENCE):
        while True:
            try:
                await cell.scene.truth()
            except UnknownOutcomeError:
                await asyncio.sleep(0.1)
            else:
                return await stands(cell)


async def _beside_a_slow_consumer(lab: Lab, manner: Manner) -> Evidence:
    frozen = manner == "frozen"
    async with lab.cell() as cell:
        await register(cell.client)
        async with consumer(cell, "idle") as go_on:
            usual = await _slowest_command(cell)
            idle = await go_on()
        async with consumer(cell, manner) as go_on:
            await asyncio.sleep(SLOW)
            beside = await _slowest_command(cell)
            async with moving(cell.client):
                await cell.client.stop()
            await held(cell)
            poses = await go_on()
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
        control={"heard_by_one_that_has_time": idle.heard, "command_beside_it_s": usual},
    )


async def _slowest_command(cell: RunningCell) -> float:
    """Seconds that the slowest of some commands takes."""
    clock = asyncio.get_running_loop().time
    taken = []
    for _ in range(20):
        begun = clock()
        await accept(cell.client, "toolplan.plan", **tool_pose())
        taken.append(clock() - begun)
    return round(max(taken), 4)
