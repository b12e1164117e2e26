"""Faults of the network: a proxy of its own stands between real sockets, or the kernel is told to fail."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

from pcmrs.campaign.checks import expect, held, stands
from pcmrs.campaign.datagrams import raw_socket, refused_all
from pcmrs.campaign.driving import (
    PATIENCE,
    accept,
    digitized,
    moving,
    plan,
    register,
    start_anew,
    state,
    tool_pose,
    until,
)
from pcmrs.campaign.fault import Evidence, Unmet, fault
from pcmrs.campaign.lab import Lab, LabCell
from pcmrs.campaign.outside import WITHOUT_NODES, outside_node
from pcmrs.campaign.proxy import tcp_proxy, udp_proxy
from pcmrs.campaign.syscalls import injected
from pcmrs.campaign.waiting import until_true
from pcmrs.campaign.weather import Weather
from pcmrs.errors import PcmrsError, UnknownOutcomeError
from pcmrs.experiment.process import free_port
from pcmrs.gateway.commands import Value
from pcmrs.messages import Snapshot
from pcmrs.planner import Planner

PROXY = "userspace proxy between planner and daemon, UDP"
WIRE = "userspace proxy between device node and daemon, TCP"
RECEIVING = ("recvmsg", "recvmmsg", "recvfrom")
COMMANDS_SENT = 12
NARROW = 100_000 / 8
"""100 kbit/s, in bytes per second."""


@fault("N1", how=PROXY)
async def datagrams_are_lost(lab: Lab) -> Evidence:
    """A fifth of the datagrams is lost, in both directions."""
    return await _once_each(lab, Weather(seed=lab.seed, loss=0.2), "lost")


@fault("N2", how=PROXY)
async def datagrams_are_doubled(lab: Lab) -> Evidence:
    """Half of the datagrams come twice."""
    return await _once_each(lab, Weather(seed=lab.seed, doubled=0.5), "doubled")


@fault("N3", how=PROXY)
async def datagrams_overtake_each_other(lab: Lab) -> Evidence:
    """A series of landmarks in any order: the whole of it is planned as sent, or it is refused with its reason."""
    weather = Weather(seed=lab.seed, jitter=0.2)
    async with lab.cell() as cell, _proxied(cell, weather) as planner:
        row = cell.last_row()
        points = [landmark.position for landmark in plan().landmarks]
        sent: list[tuple[str, tuple[Value, ...]]] = [("img_fid_numxxxxx", (len(points),))]
        sent += [("img_fid_pntxxxxx", (index, *map(float, point))) for index, point in enumerate(points)]
        sent += [("img_fid_lastrecv", ())]
        verdicts = await asyncio.gather(*(planner.command(name, *values) for name, values in sent))
        planned = [entry for entry in cell.rows(row) if entry.kind == "outcome" and entry.operation == "plan_landmarks"]
        if verdicts[-1].decision == "accepted":
            (only,) = planned
            given = [entry["position"] for entry in (only.arguments or {})["landmarks"]]
            expect(given == [list(map(float, point)) for point in points], f"The plan is {given}, sent was {points}.")
        else:
            expect(verdicts[-1].decision == "rejected" and not planned, f"The series was {verdicts[-1].decision}.")
        expect(weather.counted["overtaken"] > 0, "No datagram overtook another one: choose another seed.")
        await planner.reinitiate()
        in_order = await _run_series(planner, cell)
    seen = {"decision": verdicts[-1].decision, "reason": verdicts[-1].reason, **weather.counted, **in_order}
    return Evidence("the series whole or refused; single commands exactly once", seen)


async def _run_series(planner: Planner, cell: LabCell) -> dict[str, int]:
    """Commands that do not wait for each other, each of which must be done once."""
    row = cell.last_row()
    await asyncio.gather(*(planner.command("session_reinitxx") for _ in range(COMMANDS_SENT)))
    return {"commands": _check_once(cell, row, COMMANDS_SENT, "toolplan")}


@fault("N4", how=PROXY)
async def answers_take_half_a_second(lab: Lab) -> Evidence:
    """Half a second each way: every command is done once, also one whose sender has given up waiting."""
    weather = Weather(seed=lab.seed, delay=0.5)
    async with lab.cell() as cell, _proxied(cell, weather) as planner:
        row = cell.last_row()
        given_up = 0
        for number in range(6):
            try:
                await planner.command("session_reinitxx", timeout=0.4 if number % 2 else 10.0)
            except UnknownOutcomeError:
                given_up += 1
        expect(given_up == 3, f"{given_up} of 3 impatient commands ended in a typed timeout.")
        await _until_rows(cell, row, 6, "toolplan")
        _check_once(cell, row, 6, "toolplan")
    return Evidence("exactly once, or a typed timeout", {"timeouts": given_up, **weather.counted})


@fault("N5", how="raw datagrams")
async def an_old_buffer_completes_nothing(lab: Lab) -> Evidence:
    """After a long datagram comes the beginning of the same one, cut at every byte."""
    long = b"target_tslxxxxxx_0.101_0.202_0.303;"
    async with lab.cell() as cell:
        cuts = [piece for end in range(1, len(long)) for piece in (b"adjust_tranxxxxx_0.101_0.202_0.303;", long[:end])]
        return Evidence("refused, nothing changed", await refused_all(cell, cuts))


@fault("N6", how="raw datagrams")
async def no_terminator_and_oversize(lab: Lab) -> Evidence:
    """Without an end, with two ends, and of up to 60,000 bytes."""
    whole = b"session_reinitxx"
    async with lab.cell() as cell:
        await digitized(cell.client)
        wrong = [whole, whole + b";;", whole + b";" + whole + b";", whole + b"\0;", b";", b"\xff" * 300]
        wrong += [whole + b"_" * size + b";" for size in (256, 1500, 9000, 60_000)]
        return Evidence("refused, nothing changed", await refused_all(cell, wrong))


@fault("N7", how="raw datagrams of two planners")
async def rotation_and_translation_of_two_plans(lab: Lab) -> Evidence:
    """A translation without its rotation, or long after it, is refused; so is an approach by what is left."""
    turned, moved = b"target_rotxxxxxx_0.0_0.0_0.0_1.0", b"target_tslxxxxxx_0.01_0.02_0.11"
    async with lab.cell() as cell, raw_socket(cell.ready.links["planner"]) as other:
        await register(cell.client)
        before = await cell.client.state()
        other.send(turned + b";")
        await other.fence()
        details = await refused_all_with_reasons(cell, [moved + b"_#77;"], {"no_rotation"})
        other.send(turned + b";")
        await asyncio.sleep(1.2)
        other.send(moved + b"_#78;")
        late = b"".join(await _answers(other))
        expect(b"rotation_too_old" in late, f"The late translation was answered {late!r}.")
        expect((await cell.client.state()).plan == before.plan, "The planned pose has changed.")
        approach = await cell.planner.command("execute_motionxx")
        expect(approach.decision == "rejected", f"The approach was {approach.decision}.")
        pose = plan().poses[0]
        await cell.planner.plan_pose(pose.position, pose.quat_xyzw)
    return Evidence("refused with their reasons", {**details, "late": late.decode(), "approach": approach.reason})


@fault("N8", how="raw datagrams")
async def a_series_with_gaps(lab: Lab) -> Evidence:
    """Landmarks are missing, come twice, or lie outside the number announced."""
    point = b"_0.01_0.02_0.03"
    first = b"img_fid_pntxxxxx_00" + point + b";"
    series = {
        "a landmark is missing": ("incomplete_series", [b"img_fid_numxxxxx_03;", first]),
        "a landmark comes twice": ("no_series", [b"img_fid_numxxxxx_02;", first, first]),
        "one more than announced": ("no_series", [b"img_fid_numxxxxx_01;", b"img_fid_pntxxxxx_01" + point + b";"]),
    }
    async with lab.cell() as cell:
        await digitized(cell.client)
        details: dict[str, Any] = {}
        for number, (name, (code, datagrams)) in enumerate(series.items()):
            end = f"img_fid_lastrecv_#{1000 + number};".encode()
            details[name] = await refused_all_with_reasons(cell, [*datagrams, end], {code})
    return Evidence("refused with their reasons", details)


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
        first.process.send_signal(signal.SIGKILL)
        await first.process.wait()
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
    return Evidence("subscriptions and requests work again", {"snapshots": len(heard)})


@fault("N11", how="a subscriber to everything, frozen by SIGSTOP")
async def a_consumer_that_does_not_read(lab: Lab) -> Evidence:
    """Who reads nothing loses what he does not read; commands and Stop are as quick as before."""
    async with lab.cell() as cell:
        await register(cell.client)
        usual = await _round_trips(cell)
        async with _frozen_subscriber(cell) as subscriber:
            await asyncio.sleep(2.0)
            slow = await _round_trips(cell)
            async with moving(cell.client):
                await cell.client.stop()
            await held(cell)
            expect(subscriber.returncode is None, "The subscriber has ended.")
        await start_anew(cell.client)
    expect(max(slow) < 1.0, f"A command took {max(slow):.2f} s beside a consumer that does not read.")
    return Evidence("control unaffected", {"control": _worst(usual), "beside": _worst(slow)})


@fault("N12", how=WIRE)
async def a_wire_of_100_kbit(lab: Lab) -> Evidence:
    """Poses come too late to be believed: what needs them is refused; status and Stop work."""
    weather = Weather(seed=lab.seed)
    async with _remote_cell(lab, weather) as cell:
        await register(cell.client)
        weather.rate = NARROW
        await asyncio.sleep(4.0)
        approach = await cell.client.call("placement.approach", timeout=PATIENCE)
        expect(approach.decision == "rejected", f"By poses that are late the approach was {approach.decision}.")
        await cell.client.stop()
        snapshot = await until(cell.client, lambda shown: shown.latched)
        weather.rate = None
        await stands(cell)
    reason = approach.reason.code if approach.reason is not None else ""
    details = {"approach": approach.decision, "reason": reason, "sequence": snapshot.sequence}
    return Evidence("refused; Stop and status work", details)


@fault("N13", how=WIRE)
async def a_half_open_link(lab: Lab) -> Evidence:
    """Nothing gets through in either direction, and nobody closes anything."""
    return await _cut_in_motion(lab, towards=False, back=False)


@fault("N14", how="strace: recvmsg of the daemon fails", tools=("strace",))
async def a_socket_error(lab: Lab) -> Evidence:
    """The kernel reports errors at the receiving socket; the receiver goes on."""
    failed: dict[str, int] = {}
    async with lab.daemon() as cell:
        for error in ("ECONNREFUSED", "ENETDOWN", "ENOBUFS"):
            action = f"error={error}:when=1"
            async with injected(cell.process.pid, RECEIVING, action, threads=False) as tampered:
                with suppress(UnknownOutcomeError):
                    await cell.planner.command("stop_visualizexx", timeout=1.0)
            expect(tampered.calls > 0, f"No call was answered with {error}.")
            verdict = await cell.planner.command("stop_visualizexx", timeout=PATIENCE)
            expect(verdict.decision == "accepted", f"After {error} it was {verdict.decision}.")
            failed[error] = tampered.calls
        await cell.planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
        expect(await state(cell.client, "registration") == "100", "The planner's link is dead.")
    return Evidence("the receiver goes on", failed)


async def refused_all_with_reasons(cell: LabCell, datagrams: Sequence[bytes], codes: set[str]) -> dict[str, Any]:
    """`refused_all`, where every one that has an id is answered with one of the codes."""
    details = await refused_all(cell, datagrams, refusals=1)
    for answer in details["answers"]:
        expect(any(code in answer for code in codes), f"The answer was {answer}; {sorted(codes)} had to come.")
    expect(bool(details["answers"]), "There was no answer.")
    return details


async def _answers(raw: Any) -> list[bytes]:
    answers: list[bytes] = await raw.fence()
    return answers


async def _once_each(lab: Lab, weather: Weather, counted: str) -> Evidence:
    """Commands through bad weather: each is done exactly once, and its verdict comes."""
    async with lab.cell() as cell, _proxied(cell, weather) as planner:
        row = cell.last_row()
        for _ in range(COMMANDS_SENT):
            await planner.command("session_reinitxx", timeout=30.0)
        done = _check_once(cell, row, COMMANDS_SENT, "toolplan")
        await planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
        expect(weather.counted[counted] > 0, f"Nothing was {counted}: choose another seed.")
    return Evidence("every command exactly once", {"commands": done, **weather.counted})


@asynccontextmanager
async def _proxied(cell: LabCell, weather: Weather) -> AsyncIterator[Planner]:
    async with udp_proxy(cell.ready.links["planner"], weather) as address, await Planner.open(*address) as planner:
        yield planner


def _check_once(cell: LabCell, row: int, commands: int, branch: str) -> int:
    """The commands sent since a row have one outcome each."""
    outcomes = [entry for entry in cell.rows(row) if entry.kind == "outcome" and entry.branch == branch]
    ids = Counter((entry.source, entry.command_id) for entry in outcomes)
    if len(ids) != commands or any(count > 1 for count in ids.values()):
        raise Unmet(f"{commands} commands were sent, the journal has {len(outcomes)} outcomes of {len(ids)} commands.")
    return len(ids)


async def _until_rows(cell: LabCell, row: int, outcomes: int, branch: str) -> None:
    def complete() -> bool:
        return sum(entry.kind == "outcome" and entry.branch == branch for entry in cell.rows(row)) >= outcomes

    await until_true(complete, f"The journal has no {outcomes} outcomes")


@asynccontextmanager
async def _remote_cell(lab: Lab, weather: Weather) -> AsyncIterator[LabCell]:
    """A cell whose device node is one of another machine, as far as the wire between them goes."""
    port = free_port()
    place = lab.folder / "remote"
    place.mkdir()
    async with tcp_proxy(("127.0.0.1", port), weather) as (host, proxied):
        near = f"cell.endpoint=tcp/127.0.0.1:{port}"
        far = (f"cell.name={place.name}", f"cell.endpoint=tcp/{host}:{proxied}", "cell.rate=1", f"sim.seed={lab.seed}")
        starting = asyncio.create_task(_node_when_router(port, far, place / "node.log"))
        try:
            settings = (near, "cell.rate=1", "procedure.max_pose_age=0.5", *WITHOUT_NODES)
            async with lab.daemon(*settings, folder=place) as cell:
                yield cell
        finally:
            weather.rate, weather.towards, weather.back = None, True, True
            starting.cancel()
            with suppress(asyncio.CancelledError, PcmrsError):
                await starting


async def _node_when_router(port: int, settings: Sequence[str], log: Any) -> None:
    """Starts the node once the daemon's router listens, and ends it when cancelled."""
    while True:
        try:
            _, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.1)
            continue
        writer.close()
        break
    async with outside_node(settings, log) as node:
        await node.wait()


async def _cut_in_motion(lab: Lab, *, towards: bool, back: bool) -> Evidence:
    """Cuts the wire between node and daemon while the arm moves; `towards` is from node to daemon."""
    weather = Weather(seed=lab.seed)
    async with _remote_cell(lab, weather) as cell:
        await register(cell.client)
        clock = asyncio.get_running_loop().time
        async with moving(cell.client) as verdict:
            weather.towards, weather.back = towards, back
            cut = clock()
            shown = await until(cell.client, lambda snapshot: snapshot.latched or snapshot.branches["robot"] == "0")
            found = clock() - cut
            await asyncio.sleep(1.0)
            weather.towards, weather.back = True, True
            ended = await verdict
        expect(ended.decision != "accepted", "The approach was accepted though the wire was cut.")
        expect(ended.state in ("held", "unknown"), f"The tool counts as {ended.state}.")
        way = await _stands_when_back(cell)
        await held(cell, ("held", "unknown"))
        log = (lab.folder / "remote" / "node.log").read_text(errors="replace")
        by_node = "held_by_node" in log
        expect(back or by_node, "The node did not hold the arm by itself.")
    details = {"found_after_s": round(found, 3), "held_by_node": by_node, "latched": shown.latched, "way_m": way}
    return Evidence(f"held, {ended.state}; nothing moved when the wire was back", details)


async def _stands_when_back(cell: LabCell) -> float:
    """The arm stands, asked as soon as its node can be reached again."""
    async with asyncio.timeout(PATIENCE):
        while True:
            try:
                await cell.scene.truth()
            except UnknownOutcomeError:
                await asyncio.sleep(0.1)
            else:
                return await stands(cell)


@asynccontextmanager
async def _frozen_subscriber(cell: LabCell) -> AsyncIterator[asyncio.subprocess.Process]:
    """`pcmrs watch` in a process of its own that takes nothing from its socket any more."""
    address = ("--endpoint", cell.ready.endpoint, "--cell", cell.name)
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "pcmrs.cli", "watch", *address, stdout=asyncio.subprocess.PIPE
    )
    try:
        if process.stdout is not None:
            await process.stdout.readline()
        os.kill(process.pid, signal.SIGSTOP)
        yield process
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _round_trips(cell: LabCell) -> list[float]:
    """Seconds that commands take."""
    clock = asyncio.get_running_loop().time
    taken = []
    for _ in range(20):
        begun = clock()
        await accept(cell.client, "toolplan.plan", **tool_pose())
        taken.append(clock() - begun)
    return taken


def _worst(seconds: Sequence[float]) -> float:
    return round(max(seconds), 4)
