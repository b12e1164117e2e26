"""Faults of processes: killed, stopped, starved, blocked, or started twice."""

from __future__ import annotations

import asyncio
import resource
import signal
import sqlite3
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Collection
from contextlib import asynccontextmanager, closing, suppress
from pathlib import Path

from pcmrs.client import Client
from pcmrs.clock import SystemClock
from pcmrs.errors import BusError, UnknownOutcomeError
from pcmrs.failpoints import FAILPOINTS
from pcmrs.journal import JournalReader
from pcmrs.journal.schema import HEADLESS
from pcmrs.journal.verification import verify
from pcmrs.replay.replay import replay
from pcmrs.service.watches import stall
from pcmrs.testing.arm import stands
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE, accept, moving, register, reset_cell, tool_pose, until
from pcmrs.threads import Threads, descendants
from pcmrs_lab.campaign import cgroups
from pcmrs_lab.campaign.cgroups import memory_limit, processor_quota
from pcmrs_lab.campaign.checks import confirmed, expect, held
from pcmrs_lab.campaign.daemonkills import kill_daemons
from pcmrs_lab.campaign.damage import as_version_1
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.kills import JOURNAL_FAILPOINTS, KillReport, kill_writers
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.saboteur import order, sabotaged
from pcmrs_lab.campaign.samples import descriptors, process_state, sample
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.waiting import PERIOD, until_ended, until_logged, until_true

SLOW = ("procedure.motion.linear_velocity=0.03", "robot.deadman=0.5")
"""Settings with which every motion lasts for seconds, and a busy machine is no reason to hold."""

HELD_BY_NODE = "held_by_node"
HOLD_FAILED = "hold_failed"
"""Event names that a node logs."""
TASK = "reference watch"
"""Name of a background task of the daemon."""

CONNECTED = "connected"
UNKNOWN = 9999
"""Version of a journal that no program has written."""
QUOTA_TIME = 3.0
"""Time for which a daemon has had only a share of a processor before a motion is requested, s."""
BLOCKED_FOR = 0.3
"""Time for which the event loop is blocked, s of the machine."""
WRITERS = 30
TIGHT = 6 << 20
"""Memory that a daemon may still take when its memory is limited, bytes."""


@fault(
    "P1", how="SIGKILL at every failpoint and at random instants: of a process that writes a journal", deadline=240.0
)
async def a_writer_is_killed(lab: Lab) -> Evidence:
    """Processes that write the same journal one after the other are killed."""
    found = await asyncio.to_thread(kill_writers, WRITERS, lab.seed, SystemClock())
    return _nothing_lost(found, "row", JOURNAL_FAILPOINTS)


@fault("P1", how="SIGKILL at every failpoint and at a random instant: of the daemon in operation", deadline=600.0)
async def a_daemon_is_killed(lab: Lab) -> Evidence:
    """Daemons that follow each other on the same folder are killed."""
    found = await kill_daemons(len(FAILPOINTS) + 1, lab.seed, SystemClock())
    return _nothing_lost(found, "decision", FAILPOINTS)


def _nothing_lost(found: KillReport, what: str, failpoints: Collection[str]) -> Evidence:
    expect(not found.violated, f"{found.lost} acknowledged {what}s are lost; {found.refused}")
    missed = [name for name in failpoints if name not in found.at]
    expect(not missed, f"Nothing was killed at {', '.join(missed)}: not reached in time.")
    return Evidence(
        f"no acknowledged {what} lost",
        {"not_reached": found.not_reached},
        took_place={f"killed at {name}": count for name, count in found.at.items()},
        control_kind="without_fault",
        control={"acknowledged": found.acknowledged},
    )


@fault("P2", how="SIGTERM in the middle of a motion")
async def terminated_in_motion(lab: Lab) -> Evidence:
    """The motion is held before anything else ends; the exit is clean, and the next daemon can continue from there."""
    async with lab.daemon(*SLOW) as cell:
        nodes = descendants(cell.process.pid)
        await register(cell.client)
        control = await _move_without_fault(cell)
        row = cell.last_row()
        with suppress(UnknownOutcomeError):  # the bus may be closed before the answer is sent
            async with moving(cell.client):
                inject_unless_sham(cell.process.terminate)
                status = await until_ended(cell)
        left = [pid for pid in nodes if _is_running(pid)]
        rows = cell.rows(row)
        expect("Traceback" not in cell.log, "The log has a traceback.")
    (outcome,) = (row for row in rows if row.operation == "approach" and row.kind == "outcome" and row.verdict)
    expect(status == 0, f"It ended with exit status {status}.")
    ended = outcome.verdict.state if outcome.verdict is not None else ""
    expect(ended == "held", f"The outcome was {outcome.verdict}.")
    expect(bool(nodes) and not left, f"Of the nodes {nodes} these are still running: {left}.")
    return Evidence(
        "held, then a clean exit",
        {"status": status},
        took_place={"ended_in_motion": ended, "ended_nodes": len(nodes)},
        control_kind="without_fault",
        control=control,
    )


@fault("P3", how="SIGSTOP of the daemon in the middle of a motion")
async def the_daemon_is_stopped(lab: Lab) -> Evidence:
    """The node holds the arm by its own timer; nothing continues when the daemon does."""
    async with lab.daemon(SLOW[0]) as cell:
        await register(cell.client)
        control = await _move_without_fault(cell)
        async with moving(cell.client) as verdict:
            inject_unless_sham(lambda: cell.process.send_signal(signal.SIGSTOP))
            try:
                found = await until_logged(cell, HELD_BY_NODE)
                stopped = process_state(cell.process.pid) == "T"
            finally:
                cell.process.send_signal(signal.SIGCONT)
            ended = await verdict
        expect(ended.decision != "accepted", "The approach was accepted.")
        expect(ended.state in ("held", "unknown"), f"The tool counts as {ended.state}.")
        displacement = await stands(cell)
        await held(cell, ("held", "unknown"))
    return Evidence(
        f"held by the node, {ended.decision}, {ended.state}",
        {"way_m": displacement},
        took_place={"stopped": stopped, "held_by_node_after_s": round(found, 3)},
        control_kind="without_fault",
        control=control,
    )


@fault("P4", how="a saboteur inside the daemon keeps its event loop busy for 300 ms")
async def the_event_loop_is_blocked(lab: Lab) -> Evidence:
    """At rest an alarm is raised; in motion the arm is held and latched."""
    orders = lab.folder / "orders"
    async with lab.daemon(SLOW[0], "robot.deadman=0.1", prefix=sabotaged(orders)) as cell:
        await register(cell.client)
        control = await _move_without_fault(cell)
        row, before = cell.last_row(), (await cell.client.health()).loop
        await order(orders, f"block {BLOCKED_FOR}")
        await until_logged(cell, "stall")
        async with moving(cell.client) as verdict:
            await order(orders, f"block {BLOCKED_FOR}")
            ended = await verdict
        loop = (await cell.client.health()).loop
        # The watch checks once in a period, so the block may have begun one period earlier.
        longest = loop.longest
        expect(longest > BLOCKED_FOR - stall.PERIOD, f"The event loop was blocked for {longest:.3f} s at most.")
        expect(ended.decision != "accepted", "The approach was accepted.")
        await held(cell)
        await confirmed(cell)
        events = sorted({entry.operation or "" for entry in cell.rows(row) if entry.kind == "device"})
    return Evidence(
        "alarm at rest, held in motion",
        {"events": events, "approach": ended.decision},
        took_place={"stalls": loop.stalls - before.stalls, "longest_s": round(longest, 3)},
        control_kind="without_fault",
        control=control,
    )


@fault("P5", how="a saboteur inside the daemon raises an error in a background task")
async def a_task_dies(lab: Lab) -> Evidence:
    """The task is restarted, and the restart is reported."""
    orders = lab.folder / "orders"
    async with lab.daemon(prefix=sabotaged(orders)) as cell:
        row = cell.last_row()
        await _make_task_fail(orders, TASK)
        await until_logged(cell, "task_died")
        await register(cell.client)
        events = [entry for entry in cell.rows(row) if entry.operation == "task_restarted"]
        expect(bool(events), "The journal has no row of the restart.")
        counted = {task.name: task.restarts for task in (await cell.client.health()).tasks}
        control = await _move_without_fault(cell)
    return Evidence(
        "restarted and reported",
        {"rows": len(events)},
        took_place={"restarts": counted.get(TASK, 0)},
        control_kind="without_fault",
        control=control,
    )


@fault(
    "P6",
    how="control group: the memory of the daemon is limited, and the kernel kills it in motion",
    needs=cgroups.MEMORY,
    deadline=300.0,
)
async def memory_is_limited(lab: Lab) -> Evidence:
    """The node holds the arm before it ends, too; nothing acknowledged is lost, and the next daemon starts."""
    orders = lab.folder / "orders"
    async with lab.daemon(*SLOW, prefix=sabotaged(orders)) as cell:
        nodes = descendants(cell.process.pid)
        await register(cell.client)
        eaten = await order(orders, f"eat {8 * TIGHT}")
        control = {f"order to take {8 * TIGHT} bytes": eaten, **await _move_without_fault(cell)}
        answered = await cell.client.call("toolplan.plan", tool_pose(), id="before")
        with memory_limit([cell.process.pid], sample(cell.process.pid).memory + TIGHT) as killed:
            with suppress(UnknownOutcomeError):
                async with moving(cell.client) as verdict:
                    with suppress(TimeoutError, OSError):
                        await order(orders, "eat 2000000000")
                    await until_ended(cell)
                    await verdict
            by_kernel = killed()
        status = cell.process.returncode
        expect(status == -signal.SIGKILL, f"The daemon took more memory than it may, and ended with {status}.")
        expect(bool(nodes), "The daemon had no nodes.")
        await until_true(lambda: not any(map(_is_running, nodes)), f"Of the nodes {nodes} not all have ended")
        expect(HOLD_FAILED not in cell.log and "Traceback" not in cell.log, "The node has not held the arm.")
        with JournalReader(Path(cell.ready.journal)) as journal:
            expect(journal.verdict_of("bus:local", "before") == answered, "An acknowledged decision is lost.")
    async with lab.daemon(folder=cell.folder) as successor:
        snapshot = await successor.client.state()
    expect(snapshot.branches["robot"] == "0", "The next daemon reports the robot as connected.")
    return Evidence(
        "killed; held by the node, nothing lost",
        {"status": status},
        took_place={"killed_by_the_kernel": by_kernel},
        control_kind="without_fault",
        control=control,
    )


@fault("P7", how="prlimit: no further file descriptor")
async def no_file_descriptors(lab: Lab) -> Evidence:
    """Open connections work; a new client learns that no daemon answers, until there are descriptors again."""
    async with lab.daemon(*SLOW) as cell:
        await register(cell.client)
        pid = cell.process.pid
        before = resource.prlimit(pid, resource.RLIMIT_NOFILE)
        control = {"newcomer": await _connect_new_client(cell)}
        inject_unless_sham(lambda: resource.prlimit(pid, resource.RLIMIT_NOFILE, (3, before[1])))
        try:
            async with moving(cell.client):
                await cell.client.stop()
            await held(cell)
            status = await cell.client.state()
            refusal = await _connect_new_client(cell)
            beyond = descriptors(pid) - resource.prlimit(pid, resource.RLIMIT_NOFILE)[0]
            expect(f"No daemon answers at {cell.ready.endpoint}" in refusal, f"A new client reports: {refusal}")
        finally:
            resource.prlimit(pid, resource.RLIMIT_NOFILE, before)
        await confirmed(cell)
        again = await _connect_new_client(cell)
        expect(again == CONNECTED, f"There are descriptors again, and a new client reports: {again}")
        await reset_cell(cell.client)
    return Evidence(
        "Stop and status work; no new client is admitted",
        {"newcomer": refusal, "sequence": status.sequence},
        took_place={"open_beyond_the_limit": max(0, beyond)},
        control_kind="without_fault",
        control=control,
    )


@fault("P8", how="control group: the daemon gets 2 % of a processor", needs=cgroups.PROCESSOR)
async def processor_is_limited(lab: Lab) -> Evidence:
    """Stop and status work; operations that need fresh poses are refused or held, never accepted late."""
    async with lab.daemon(SLOW[0], "cell.rate=1", "procedure.max_pose_age=0.1") as cell:
        await register(cell.client)
        control = await _move_without_fault(cell)
        threads = Threads(cell.process.pid)
        threads.waited()
        with processor_quota([cell.process.pid], 0.02):
            await asyncio.sleep(QUOTA_TIME)
            waited = round(threads.waited(), 3)
            approach = await cell.client.call("placement.approach", timeout=PATIENCE)
            expect(approach.decision != "accepted", "The approach was accepted.")
            await cell.client.stop(timeout=PATIENCE)
            status = await cell.client.state(timeout=PATIENCE)
        await until(cell.client, lambda shown: shown.latched)
        await stands(cell)
    reason = approach.reason.code if approach.reason is not None else ""
    details = {"approach": approach.decision, "reason": reason, "sequence": status.sequence}
    return Evidence(
        "refused or held; Stop and status work",
        details,
        took_place={"a_thread_waited_s": waited if waited > QUOTA_TIME / 3 else 0},
        control_kind="without_fault",
        control=control,
    )


@fault("P9", how="a saboteur inside the daemon makes a background task fail repeatedly, in motion")
async def a_crash_loop(lab: Lab) -> Evidence:
    """When its restarts are used up the daemon holds the arm and ends with an error."""
    orders = lab.folder / "orders"
    async with lab.daemon(*SLOW, prefix=sabotaged(orders)) as cell:
        await register(cell.client)
        control = await _move_without_fault(cell)
        with suppress(UnknownOutcomeError):
            async with moving(cell.client):
                for _ in range(100):
                    with suppress(TimeoutError, OSError):
                        await order(orders, f"fail {TASK}")
                    if cell.process.returncode is not None:
                        break
                    await asyncio.sleep(0.05)
        status = await until_ended(cell)
        rows = cell.rows()
    expect(status not in (0, -signal.SIGKILL), f"It ended with exit status {status}.")
    last = next(row for row in reversed(rows) if row.operation == "approach" and row.verdict is not None)
    expect(last.verdict is not None and last.verdict.state in ("held", "unknown"), f"The outcome was {last.verdict}.")
    expect("died more than" in cell.log, "The log does not give the reason for the end.")
    restarts = sum(row.operation == "task_restarted" for row in rows)
    return Evidence(
        "held, then ended with an error",
        took_place={"exit_status": status, "restarts": restarts},
        control_kind="without_fault",
        control=control,
    )


@fault("P10", how="a second daemon on the same folder, and one on the same bus", deadline=300.0)
async def a_second_daemon(lab: Lab) -> Evidence:
    """The second daemon is refused with the reason, and the first one continues."""
    async with lab.daemon() as cell:
        same = f"cell.endpoint={cell.ready.endpoint}"
        folder = await lab.start_refused(folder=None if is_sham() else cell.folder)
        endpoint = await lab.start_refused(same)
        await register(cell.client)
    expect(folder[0] == 4 and "Another daemon runs this cell" in folder[1], f"Exit status {folder[0]}: {folder[1]}")
    expect(endpoint[0] == 3 and "another daemon is there" in endpoint[1], f"Exit status {endpoint[0]}: {endpoint[1]}")
    async with lab.daemon(same, folder=cell.folder) as alone:
        control = await alone.client.call("registration.reinit")
        expect(control.decision == "accepted", f"Once the first has ended, a command is {control.decision}.")
    return Evidence(
        "refused with exit status 4 and 3",
        took_place={"on_the_folder_exit_status": folder[0], "on_the_bus_exit_status": endpoint[0]},
        control_kind="without_fault",
        control={"once_the_first_has_ended": control.decision},
    )


@fault("P11", how="a subscriber to everything whose callback never returns, in a separate process")
async def a_callback_that_never_returns(lab: Lab) -> Evidence:
    """Only that process is blocked."""
    async with lab.cell() as cell, _blocked_subscriber(cell) as messages:
        await register(cell.client)
        clock = asyncio.get_running_loop().time
        started = clock()
        for _ in range(20):
            await accept(cell.client, "toolplan.plan", **tool_pose())
        taken = (clock() - started) / 20
        async with moving(cell.client):
            await cell.client.stop()
        await held(cell)
        blocked = await messages()
        await reset_cell(cell.client)
    async with lab.cell() as cell, _blocked_subscriber(cell, blocks=False) as messages:
        received = await messages(more=True)
        expect(received > 1, "A subscriber whose callback returns has not received more than one message either.")
    expect(taken < 0.5, f"A command took {taken:.2f} s.")
    return Evidence(
        "the bus is unaffected",
        took_place={"alive_with_one_message": blocked == 1},
        control_kind="without_fault",
        control={"messages_where_it_returns": received},
        details={"command_s": round(taken, 4)},
    )


@fault("P12", how="wrong settings on the command line and in a file", deadline=300.0)
async def bad_configuration(lab: Lab) -> Evidence:
    """Each is refused with exit status 4, and by name; nothing is left in the folder."""
    right = ("robot.model=iiwa14", "cell.rate=5", "robot.driver=sim", "gateway.planner={port=0}", "workflow=ratms")
    wrong = {
        "robot.model=no_such_arm": "no_such_arm",
        "cell.rate=0.1": "rate",
        "procedure.no_such_key=1": "no_such_key",
        "robot.driver=no_such_driver": "no_such_driver",
        "gateway.planner={port=99999}": "port",
        "workflow=/no/such/workflow.toml": "workflow.toml",
    }
    async with lab.daemon(*right) as cell:
        control = await accept(cell.client, "registration.reinit")
    statuses: dict[str, int] = {}
    for setting, named in wrong.items():
        folder = lab.folder / f"wrong{len(statuses)}"
        given = right if is_sham() else (setting,)
        statuses[setting], errors = await lab.start_refused(*given, folder=folder)
        expect(statuses[setting] == 4, f"{setting}: exit status {statuses[setting]}: {errors}")
        expect(named in errors and "Traceback" not in errors, f"{setting}: {errors}")
        expect(not list(folder.glob("*.sqlite")), f"{setting}: a journal was created.")
    return Evidence(
        "named error and exit status 4",
        took_place={f"exit status with {setting}": status for setting, status in statuses.items()},
        control_kind="without_fault",
        control={"with_right_settings": control.decision},
    )


@fault("P13", how="the journal of a run, rewritten in version 1 of its format", deadline=300.0)
async def a_journal_of_an_older_version(lab: Lab) -> Evidence:
    """The journal is accepted, keeps its decisions, can be replayed, and has a signed head from then on."""
    async with lab.daemon(SLOW[1]) as cell:
        await register(cell.client)
        answered = await cell.client.call("toolplan.plan", tool_pose(), id="before")
        await accept(cell.client, "placement.approach")
    journal = Path(cell.ready.journal)
    rows = await asyncio.to_thread(as_version_1, journal)
    version = _version(journal)
    expect(version == HEADLESS, f"The journal is of version {version}.")
    _version(journal, UNKNOWN)
    unknown, text = await lab.start_refused(SLOW[1], folder=cell.folder)
    expect(unknown != 0 and "version" in text, f"With an unknown version: exit status {unknown}: {text}")
    _version(journal, HEADLESS)
    async with lab.daemon(SLOW[1], folder=cell.folder) as successor:
        repeated = await successor.client.call("toolplan.plan", tool_pose(), id="before")
        expect(repeated == answered, f"A repeated command was answered {repeated}, first {answered}.")
        await register(successor.client)
    replayed = await asyncio.to_thread(replay, journal, SystemClock())
    expect(replayed.is_same, f"{len(replayed.differences)} decisions differ: {replayed.differences[:2]}")
    verified = await asyncio.to_thread(verify, journal)
    expect(verified.sound and verified.signature == "holds", f"{verified.problems}")
    return Evidence(
        "accepted and replayed",
        {"compared": replayed.compared, "signed": verified.signed},
        took_place={"version": version, "rows": rows},
        control_kind="without_fault",
        control={"exit_status_of_an_unknown_version": unknown},
    )


def _version(journal: Path, new_version: int | None = None) -> int:
    """Return the version of a closed journal from its file, after changing it to `new_version` if given."""
    with closing(sqlite3.connect(journal)) as file, file:
        if new_version is not None:
            file.execute(f"PRAGMA user_version = {new_version}")
        (version,) = file.execute("PRAGMA user_version").fetchone()
    return int(version)


async def _move_without_fault(cell: RunningCell) -> dict[str, str]:
    """Return the result of the motion without the fault; afterwards the tool is retracted again."""
    approach = await accept(cell.client, "placement.approach")
    await accept(cell.client, "placement.home")
    return {"approach": approach.decision, "reached": approach.state}


async def _make_task_fail(orders: Path, task: str) -> None:
    """Raise an error in the future that a task awaits; retry, since on a busy machine the task may be ready to run."""
    clock = SystemClock()
    end = clock.monotonic() + PATIENCE
    while await order(orders, f"fail {task}") != "failed":
        expect(clock.monotonic() < end, f"Nothing made the task {task} fail.")
        await clock.sleep(PERIOD)


def _is_running(pid: int) -> bool:
    """Return whether a process is still one of PCMRS: its id may belong to another process now."""
    with suppress(OSError):
        return b"pcmrs" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


async def _connect_new_client(cell: RunningCell) -> str:
    """Return the result of a new client: `CONNECTED`, or the error."""
    try:
        async with asyncio.timeout(PATIENCE), Client.connect(cell.ready.endpoint, cell=cell.name) as client:
            await client.state()
    except BusError as error:
        return error.text
    return CONNECTED


BLOCKED = """
import json, sys, time, zenoh
config = zenoh.Config()
for key, value in {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}.items():
    config.insert_json5(key, json.dumps(value))
def never(sample):
    print("heard", flush=True)
    if sys.argv[3] == "blocks":
        time.sleep(3600)
session = zenoh.open(config)
subscriber = session.declare_subscriber(sys.argv[2] + "/**", never)
time.sleep(3600)
"""


@asynccontextmanager
async def _blocked_subscriber(
    cell: RunningCell, *, blocks: bool = True
) -> AsyncIterator[Callable[..., Awaitable[int]]]:
    """Start a subscriber to everything; yield a function that returns how many messages its callback has received."""
    word = "blocks" if blocks and not is_sham() else "returns"
    words = (sys.executable, "-c", BLOCKED, cell.ready.endpoint, cell.ready.prefix, word)
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    received = 0

    async def count() -> None:
        nonlocal received
        if process.stdout is not None:
            async for _ in process.stdout:
                received += 1

    async def messages(*, more: bool = False) -> int:
        if more:
            await until_true(lambda: received > 1, "The subscriber has not received two messages")
        expect(process.returncode is None, "The subscriber has ended.")
        return received

    counting = asyncio.create_task(count())
    try:
        await until_true(lambda: received > 0, "The subscriber has received nothing")
        yield messages
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()
        await counting
