"""Deliberate attacks that need no access control: floods, magic texts, forged files."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import sqlite3
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.console.planning.importer import PointsRequest, RefusalAnswer
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.gateway.auth.peers import FRESH_FOR
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.gateway.tcp import MOST_OF_A_HOST
from pcmrs.journal import JournalReader, verify
from pcmrs.testing.arm import unmoved
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import (
    PATIENCE,
    accept,
    approach_alone,
    digitize_landmarks,
    moving,
    register,
    reset_cell,
    tool_pose,
    until,
)
from pcmrs.testing.journal import append_past_head, append_without_key
from pcmrs_lab.campaign.checks import confirmed, expect, held, refused, refused_at_edge, reported, shape
from pcmrs_lab.campaign.datagrams import Raw, raw_socket, refused_all, send_accepted
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.flood import flood
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.lateness import percentile, timer_lateness
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.stop_limits import exceeded
from pcmrs_lab.campaign.tools import ended
from pcmrs_lab.campaign.tries import COMMANDS, DELAYED, FLOODING, LOCAL_ACCOUNT, UNKNOWN, record
from pcmrs_lab.campaign.waiting import until_true
from pcmrs_lab.campaign.without_guard import without_guards

FLOOD = 40_000.0
"""Datagrams per second."""

STOPS = 100
"""Number of Stops whose p99 is checked: of fewer it would be their maximum."""
STOPS_AT_THE_SOCKET = 20
"""Number of Stops at the flooded socket, which loses datagrams: the planner repeats a press until it is answered."""
SPAM = 2_000
BATCH = 50
"""Number of Stops that are sent before their answers are awaited: more would not fit into the socket's buffer."""

POINTS = 25
"""Number of digitized surface points: enough to refine a registration."""

SILENT = 1_100
"""Number of simultaneous connections: more than the usual limit of 1,024 descriptors of a process."""

DEAF = 3.0
"""Time without an answer after which a receiver counts as closed, s of the machine; it answers within milliseconds."""

TOO_MANY_LANDMARKS = b"img_fid_numxxxxx_1000;"
RIGHT = "0.1"
WRONG_NUMBERS = ("nan", "1e999", "-1e999", "٣", "1_000", "inf", "0x10", "1,5", "")
MAGIC = (
    b"close", b"quit", b"exit", b"shutdown", b"q", b"stop", b"end", b"\x03", b"\x04", b"\x1a",
    b"close;", b"quit;", b"exit;", b"shutdown;", b"end_session;", b"end_communication",
)  # fmt: skip

TAKEN_OVER = """
import os, socket, subprocess, sys
from pcmrs.console.planning import importer
from pcmrs.errors import PcmrsError
how, folder, terminal, is_sham = sys.argv[1:]
os.chdir(folder)
file = os.open("written", os.O_WRONLY)
def fork():
    if os.fork() == 0:
        os._exit(0)
acts = (
    (socket.socket,), (subprocess.run, ["true"]), (fork,), (bytes, 2**31), (os.write, file, b"x"),
    (os.unlink, "removed"), (os.truncate, "emptied", 0), (os.open, terminal, os.O_WRONLY | os.O_NOCTTY),
    (os.kill, os.getppid(), 0),
)
def taken_over(path):
    said = []
    for act, *words in acts[:0] if is_sham == "yes" else acts:
        try:
            act(*words)
            said.append("done")
        except (OSError, MemoryError) as error:
            said.append(type(error).__name__)
    raise PcmrsError(" ".join(said))
importer.read_points = taken_over
if how == "free":
    importer.confine = lambda memory, seconds: None
importer.main()
"""
"""Actions that a malicious file could make its reader perform."""
ACTS = 9


@fault(
    "A4",
    how="a process that sends 40,000 datagrams per second, nearly all of them refused",
    deadline=240.0,
    tries={FLOODING: ["UDP"]},
)
async def stop_under_a_flood(lab: Lab) -> Evidence:
    """Stop works while the planner's socket is flooded, over the bus in time, and at that socket itself."""
    async with lab.daemon("cell.rate=1", "procedure.max_pose_age=0.5", "robot.deadman=0.5") as cell:
        await register(cell.client)
        async with flood(cell.ready.links["planner"], FLOOD, lab.seed), moving(cell.client):
            await cell.client.stop()
            await until(cell.client, lambda shown: shown.latched)
        await held(cell)
        quiet, before = await stop_times(cell, STOPS), (await cell.client.health()).datagrams
        async with flood(cell.ready.links["planner"], FLOOD, lab.seed) as sent, timer_lateness() as timer:
            taken = await stop_times(cell, STOPS)
            arrived = (await cell.client.health()).datagrams - before  # without the presses at the socket
            at_the_socket = await stop_times(cell, STOPS_AT_THE_SOCKET, cell.planner.stop)
        await confirmed(cell)
        await reset_cell(cell.client)
    details = {"rate_hz": round(sent.rate), **in_ms("stop", taken), **in_ms("timer", timer.late)}
    details |= in_ms("confirmed_at_the_flooded_socket", at_the_socket)
    late = " ".join(exceeded(taken, timer.late))
    expect(not late, f"Stop over the bus was late: {late} {details}")
    return Evidence(
        f"Stop over the bus begun after {max(taken) * 1e3:.1f} ms at most",
        took_place={"arrived_at_the_gateway": arrived},
        control_kind="permitted",
        control={"answers_to_commands_of_the_flood": sent.answers},
        details={**details, **in_ms("stop_without_flood", quiet)},
    )


@fault("A5", how="raw datagrams", tries={UNKNOWN: ["UDP"]})
async def magic_texts(lab: Lab) -> Evidence:
    """Texts that might close a receiver are refused, alone and as a part of a datagram."""
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        details = await refused_all(cell, [*MAGIC, *(b"x" * 16 + m for m in MAGIC)])
        control = await send_accepted(cell, b"stop_visualizexx_#1;")
    async with lab.daemon(prefix=without_guards("a_text_ends_the_receiver")) as other:
        await send_accepted(other, b"stop_visualizexx_#1;")
        async with raw_socket(other.ready.links["planner"]) as raw:
            raw.send(MAGIC[0])
            raw.send(b"stop_visualizexx_#2;")
            answers = await _answers(raw, 1, DEAF)
    expect(not answers, f"A receiver that obeys {MAGIC[0]!r} has answered {answers}.")
    return Evidence(
        "refused, the receiver continues",
        took_place={"refused_in_the_journal": details.pop("refused")},
        control_kind="mutant",
        control={"a_receiver_that_obeys_is_deaf": not answers, "a_command_instead": control},
        details=details,
    )


@fault("A6", how="raw datagrams and requests on the bus", tries={UNKNOWN: ["UDP"], LOCAL_ACCOUNT: [COMMANDS]})
async def unknown_commands_and_bad_numbers(lab: Lab) -> Evidence:
    """Unknown commands, and invalid indices and numbers, are refused."""
    wrong = [b"no_such_commandx;", b"img_fid_numxxxxx_-1;", TOO_MANY_LANDMARKS, b"img_dig_digitize_x;"]
    wrong += [b"target_tslxxxxxx_1_2;", b"target_tslxxxxxx_1_2_3_4;", b"target_tslxxxxxx_1_2_x;"]
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        async with unmoved(cell):
            details = await refused_all(cell, wrong)
            for name, arguments, code in (
                ("registration.no_such_operation", {}, "unknown_operation"),
                ("no_such_branch.reinit", {}, "unknown_branch"),
                ("toolplan.plan", {"position": [1, 2], "quat_xyzw": [0, 0, 0, 1]}, "bad_arguments"),
                ("toolplan.plan", {"position": ["1", "2", "x"], "quat_xyzw": [0, 0, 0, 1]}, "bad_arguments"),
            ):
                await refused(cell, name, arguments, codes=(code,))
                record(LOCAL_ACCOUNT, COMMANDS)
                details[f"{name} {arguments}"] = code
        right = await right_numbers(cell, details)
        planned = await accept(cell.client, "toolplan.plan", **tool_pose())
    async with lab.daemon(prefix=without_guards("an_index_of_any_kind")) as other:
        control = await send_accepted(other, TOO_MANY_LANDMARKS.replace(b";", b"_#1;"))
    return Evidence(
        "refused, nothing changed",
        took_place={"refused_in_the_journal": details.pop("refused")},
        control_kind="mutant",
        control={"such_an_index_without_the_guard": control},
        details={**details, "right_number": right, "right_plan": planned.decision},
    )


async def right_numbers(cell: RunningCell, details: Mapping[str, Any]) -> str:
    """Return the answer to a target of valid numbers, as a control.

    The invalid numbers must have been refused for themselves, and not because a rotation was missing.

    Args:
        cell: Cell that receives the target.
        details: Details of the refusals.

    Raises:
        Unmet: The target was not accepted, or the numbers were refused for another reason.
    """
    expect("no_rotation" not in details["reasons"], f"They were refused for {details['reasons']}.")
    return await send_accepted(
        cell, b"target_rotxxxxxx_0_0_0_1_#1;", f"target_tslxxxxxx_{RIGHT}_{RIGHT}_{RIGHT}_#2;".encode()
    )


@fault("A7", how="raw datagrams and requests on the bus", tries={UNKNOWN: ["UDP"], LOCAL_ACCOUNT: [COMMANDS]})
async def numbers_that_only_some_parsers_read(lab: Lab) -> Evidence:
    """Numbers that Python's own conversion would accept, or read as infinite, are refused."""
    wrong = [f"target_tslxxxxxx_{RIGHT}_{RIGHT}_{number};".encode() for number in WRONG_NUMBERS]
    wrong += [f"img_fid_numxxxxx_{number};".encode() for number in WRONG_NUMBERS]
    async with lab.cell() as cell:
        await register(cell.client)
        row = cell.last_row()
        async with unmoved(cell):
            details = await refused_all(cell, wrong)
            for number in (float("nan"), float("inf")):
                await refused_at_edge(cell, "toolplan.plan", _pose(number), code="malformed")
                record(LOCAL_ACCOUNT, COMMANDS)
            for text in ("1", None):
                await refused(cell, "toolplan.plan", _pose(text), codes=("bad_arguments",))
            malformed = await reported(cell, row, edge="bus", code="malformed", count=2)
        right = await right_numbers(cell, details)
        planned = await accept(cell.client, "toolplan.plan", **tool_pose())
    async with lab.daemon(prefix=without_guards("numbers_as_python_reads_them", "numbers_beyond_all_bounds")) as other:
        reached = await _decided_targets(other, wrong[0])
    return Evidence(
        "refused, nothing changed",
        took_place={"refused_in_the_journal": details.pop("refused"), "malformed_on_the_bus": malformed},
        control_kind="mutant",
        control={"decided_by_the_dispatcher_without_the_guards": reached},
        details={**details, "right_number": right, "right_plan": planned.decision},
    )


async def _decided_targets(cell: RunningCell, translation: bytes) -> int:
    """Send a rotation and then a translation, and return how many targets the dispatcher has decided on."""
    row = cell.last_row()
    async with raw_socket(cell.ready.links["planner"]) as raw:
        raw.send(b"target_rotxxxxxx_0_0_0_1;")
        raw.send(translation)
        await raw.fence()

    def decided() -> int:
        return sum((each.branch, each.operation) == ("toolplan", "plan") for each in cell.rows(row))

    await until_true(lambda: decided() > 0, f"Without its guard, too, {translation!r} did not reach the dispatcher")
    return decided()


def _pose(number: object) -> dict[str, Any]:
    return {"position": [0.0, 0.0, number], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}


@fault("A8", how="raw datagrams", tries={UNKNOWN: ["UDP"]})
async def paths_from_the_network(lab: Lab) -> Evidence:
    """Paths to other files: only the last part counts, and must name a configured surface."""
    secret = lab.folder / "secret.ply"
    secret.write_text("ply")
    paths = (
        f"{secret}",
        "../../../etc/passwd",
        f"..\\..\\{secret.name}",
        "C:\\Windows\\win.ini",
        "\\\\host\\share\\x.ply",
    )
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        await accept(cell.client, "digitization.digitize_surface", points=POINTS)
        before, files = await cell.client.state(), set(cell.folder.rglob("*"))
        row = cell.last_row()
        verdicts = {path: await cell.planner.command("icp_registerxxxx", path) for path in paths if not is_sham()}
        record(UNKNOWN, "UDP")
        decided = [each.verdict for each in cell.rows(row) if each.operation == "refine" and each.verdict]
        after = await until(cell.client, lambda shown: not shown.running)
        new = set(cell.folder.rglob("*")) - files
        control = await cell.planner.command("icp_registerxxxx", "/home/lab/skin_of_head/head_phantom.ply")
        expect(control.decision == "accepted", f"A path to the configured surface was {control}.")
    async with lab.daemon(prefix=without_guards("any_path_is_the_surface")) as other:
        await digitize_landmarks(other.client)
        await accept(other.client, "digitization.digitize_surface", points=POINTS)
        obeyed = await other.planner.command("icp_registerxxxx", paths[0])
        expect(obeyed.decision == "accepted", f"Without the guard {paths[0]} was {obeyed}.")
    reasons = [verdict.reason.code for verdict in decided if verdict.reason]
    expect(reasons == ["unknown_surface"] * len(paths), f"They were refused for {reasons}.")
    accepted = [path for path, verdict in verdicts.items() if verdict.decision == "accepted"]
    expect(not accepted, f"{accepted} were accepted.")
    expect(shape(before) == shape(after), f"The state has changed: {before} became {after}.")
    expect(not new, f"Files were created: {new}.")
    return Evidence(
        "refused, no file was touched",
        took_place={"refused_in_the_journal": reasons},
        control_kind="mutant",
        control={"such_a_path_without_the_guard": obeyed.decision, "configured_surface": control.decision},
        details={path: verdict.reason for path, verdict in verdicts.items()},
    )


@fault("A10", how="raw datagrams", tries={FLOODING: ["UDP"]})
async def stop_spam(lab: Lab) -> Evidence:
    """Thousands of Stops: the first one stops, all are honoured, and the cell can be used again."""
    async with lab.cell() as cell:
        await register(cell.client)
        row = cell.last_row()
        async with moving(cell.client), raw_socket(cell.ready.links["planner"]) as raw:
            answers: list[bytes] = []
            for first in range(1, SPAM, BATCH):
                for number in range(first, first + BATCH):
                    raw.attack(f"stop_now_xxxxxxx_#{number};".encode())
                    record(FLOODING, "UDP")
                answers += await _answers(raw, BATCH)
                expect(len(answers) == first + BATCH - 1, f"Of {first + BATCH - 1} Stops {len(answers)} were answered.")
        await held(cell)
        await confirmed(cell)
        honoured = sum(b"_accepted_" in answer for answer in answers)
        reports = [entry for entry in cell.rows(row) if entry.kind == "device"]
        again = [entry.result or {} for entry in reports if entry.operation == PRESSED_AGAIN]
        stops = sum(entry.operation == "stopped" for entry in reports) + sum(
            each["fields"]["presses"] for each in again
        )
        expect(honoured == SPAM, f"Of {SPAM} Stops {honoured} were confirmed.")
        expect(stops == SPAM, f"Of {SPAM} Stops the journal counts {stops}.")
        await reset_cell(cell.client)
        alone = await approach_alone(cell.client)
    return Evidence(
        "all honoured, held until confirmed",
        took_place={"counted_in_the_journal": stops},
        control_kind="permitted",
        control={"stops_that_were_honoured": honoured, "approach_without_stop": alone.decision},
        details={"sent": SPAM},
    )


@fault("A19", how="the bytes that a browser sends, and pieces of them", tries={"web page": ["TCP"]})
async def a_web_page(lab: Lab) -> Evidence:
    """The headers of a request are no commands; its body contains one."""
    command = b"rob_conn_onxxxxx_#1;"
    head = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\n"
    requests = [head + b";" + command, b"POST /;" + command + b" HTTP/1.1\r\n\r\n", b"rob_conn\r\n;" + command]
    async with lab.daemon() as cell:
        row = cell.last_row()
        async with unmoved(cell):
            answers = [await _first_answer(cell, request) for request in requests if not is_sham()]
            record("web page", "TCP")
            malformed = await reported(cell, row, edge="gateway", code="malformed", count=len(requests))
        expect(not any(answers), f"The answers were {answers}.")
        control = await _first_answer(cell, command)
        expect(control.startswith(b"1_accepted"), f"The command by itself was answered {control!r}.")
    async with lab.daemon(prefix=without_guards("tcp_goes_on_behind_a_wrong_frame")) as other:
        obeyed = await _first_answer(other, requests[0])
        expect(obeyed.startswith(b"1_accepted"), f"Without the guard the request was answered {obeyed!r}.")
    return Evidence(
        "ended at the first wrong byte",
        took_place={"malformed_in_the_journal": malformed},
        control_kind="mutant",
        control={"the_request_without_the_guard": obeyed.decode(), "the_command_by_itself": control.decode()},
    )


@fault("A20", how="TCP connections that send nothing", tries={FLOODING: ["TCP"]})
async def silent_connections(lab: Lab) -> Evidence:
    """Silent connections would use up the daemon's descriptors; the tool moves, and Stop is pressed over the bus."""
    async with lab.daemon() as cell:
        await register(cell.client)
        row, (host, port) = cell.last_row(), cell.ready.links["tcp"]
        opened = [await asyncio.open_connection(host, port) for _ in range(0 if is_sham() else SILENT)]
        record(FLOODING, "TCP")
        try:
            rejected = await reported(
                cell, row, edge="gateway", code="too_many_connections", count=SILENT - MOST_OF_A_HOST
            )
            async with moving(cell.client):
                await cell.client.stop()
            await held(cell)
            refused_now = await _first_answer(cell, b"rob_conn_onxxxxx_#1;")
        finally:
            for _, writer in opened:
                writer.close()
        expect(not refused_now, f"One more connection was answered {refused_now!r}.")
        async with asyncio.timeout(PATIENCE):
            while not (control := await _first_answer(cell, b"get_jnt_angsxxxx_#2;")):
                pass  # the daemon notices the closed connections one after the other
        await confirmed(cell)
    unlimited = without_guards("any_number_of_connections", "any_number_of_connections_from_one_address")
    async with lab.daemon(prefix=unlimited) as other:
        kept = await _descriptors_of_silent(other)
    return Evidence(
        "bounded, and Stop works",
        took_place={"turned_away_in_the_journal": rejected},
        control_kind="mutant",
        control={"descriptors_taken_without_the_guard": kept},
        details={"connections": SILENT, "one_more_when_they_are_closed": control.decode()},
    )


async def _descriptors_of_silent(cell: RunningCell) -> int:
    """Return how many descriptors of the daemon silent connections take, more than its limit permits."""
    before, many = _descriptors(cell), 4 * MOST_OF_A_HOST
    opened = [await asyncio.open_connection(*cell.ready.links["tcp"]) for _ in range(many)]
    try:
        await until_true(lambda: _descriptors(cell) - before >= many, f"{many} connections take fewer descriptors")
        return _descriptors(cell) - before
    finally:
        for _, writer in opened:
            writer.close()


def _descriptors(cell: RunningCell) -> int:
    """Return the number of open descriptors of the daemon, as the kernel counts them."""
    return len(list(Path(f"/proc/{cell.process.pid}/fd").iterdir()))


@fault("A25", how="a signed command that is delivered seconds after it was sent", tries={DELAYED: ["UDP"]})
async def held_back(lab: Lab) -> Evidence:
    """An attacker on the route delays a datagram, and delivers it long after it was sent."""
    key = lab.folder / "timed.key"
    new_key(key)
    signer = Signer("timed", read_key(key))
    table = {"key_file": str(key), "counter": "unix_ns", "role": "operator", "allow": ["robot"]}
    settings = [f"gateway.peers.timed.{setting}={json.dumps(value)}" for setting, value in table.items()]
    held = signer.sign(b"rob_conn_onxxxxx_#1;")
    async with lab.daemon(*settings) as cell, raw_socket(cell.ready.links["planner"]) as raw:
        if is_sham():
            held = signer.sign(b"rob_conn_onxxxxx_#1;")
        else:
            await asyncio.sleep(FRESH_FOR + 0.5)
        row = cell.last_row()
        async with unmoved(cell):
            (answer,) = await _send_and_receive(raw, held)
            record(DELAYED, "UDP")
            too_old = await reported(cell, row, edge="gateway", code="too_old", count=1)
        expect(b"_rejected_" in answer and b"too_old;" in answer, f"It was answered {answer!r}.")
        (fresh,) = await _send_and_receive(raw, signer.sign(b"rob_conn_onxxxxx_#2;"))
        expect(b"_accepted_" in signer.check(fresh), f"A fresh command was answered {fresh!r}.")
    prefix = without_guards("commands_may_be_held_back")
    async with lab.daemon(*settings, prefix=prefix) as other, raw_socket(other.ready.links["planner"]) as raw:
        (control,) = await _send_and_receive(raw, held)
        expect(b"_accepted_" in signer.check(control), f"Without the guard it was answered {control!r}.")
    return Evidence(
        "refused as too old",
        took_place={"too_old_in_the_journal": too_old},
        control_kind="mutant",
        control={"the_same_datagram_without_the_guard": control.decode(), "fresh": fresh.decode()},
        details={"answer": answer.decode()},
    )


@fault(
    "A26",
    how="the program that reads uploaded files, its parser taken over, with its limits and without",
    tries={LOCAL_ACCOUNT: ["uploads"]},
)
async def a_reader_is_taken_over(lab: Lab) -> Evidence:
    """A file makes its reader try connections, programs, processes, signals, memory, files and a terminal."""
    tries, left, pipe = {}, {}, asyncio.subprocess.PIPE
    request = msgspec.msgpack.encode(PointsRequest("patient.json", memory=2**30, seconds=60))
    master, terminal = os.openpty()
    for how in ("confined", "free"):
        folder = lab.folder / how
        folder.mkdir()
        for name in ("written", "removed", "emptied"):
            (folder / name).write_text(name)
        words = (sys.executable, "-c", TAKEN_OVER, how, str(folder), os.ttyname(terminal), "yes" if is_sham() else "no")
        process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)
        answer, _ = await process.communicate(request)
        record(LOCAL_ACCOUNT, "uploads")
        tries[how] = msgspec.msgpack.decode(answer, type=RefusalAnswer).text.split()
        left[how] = {file.name: file.read_text() for file in sorted(folder.iterdir())}
    for descriptor in (master, terminal):
        os.close(descriptor)
    expect(
        tries["free"] == ["done"] * ACTS, f"Without limits the results were {tries['free']}: the attack did not happen."
    )
    expect(
        len(tries["confined"]) == ACTS and "done" not in tries["confined"],
        f"With limits the results were {tries['confined']}.",
    )
    unchanged = {name: name for name in ("emptied", "removed", "written")}
    changed = {"emptied": "", "written": "xritten"}
    expect(left == {"confined": unchanged, "free": changed}, f"The files are {left}.")
    return Evidence(
        "each is refused by the kernel",
        took_place={"refused_by_the_kernel": tries["confined"]},
        control_kind="mutant",
        control={"without_limits": tries["free"], "files": left["free"]},
    )


async def _send_and_receive(raw: Raw, sent: bytes) -> list[bytes]:
    raw.send(sent)
    return await _answers(raw, 1)


async def _first_answer(cell: RunningCell, sent: bytes) -> bytes:
    """Return the first answer of the TCP link; empty if the connection ends."""
    reader, writer = await asyncio.open_connection(*cell.ready.links["tcp"])
    try:
        writer.write(sent)
        async with asyncio.timeout(PATIENCE):
            return await reader.read(100)
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


@fault("A16", how="SQL on the file, its guards removed first", deadline=300.0, tries={LOCAL_ACCOUNT: ["journal"]})
async def the_journal_is_edited(lab: Lab) -> Evidence:
    """A row is changed without its hash; a start reads only from the last snapshot, verifying reads all."""
    async with lab.daemon() as cell:
        await accept(cell.client, "registration.reinit")
        journal = Path(cell.ready.journal)
    whole = await asyncio.to_thread(verify, journal)
    expect(whole.sound, f"The unedited journal is verified as {whole}.")
    with closing(sqlite3.connect(journal)) as connection:
        (guard,) = connection.execute("SELECT sql FROM sqlite_master WHERE name = 'no_update'").fetchone()
        edit = f"DROP TRIGGER no_update; UPDATE journal SET body = zeroblob(20) WHERE sequence = 2; {guard};"  # noqa: S608  # of the file itself
        inject_unless_sham(lambda: connection.executescript(edit))
        record(LOCAL_ACCOUNT, "journal")
        (body,) = connection.execute("SELECT body FROM journal WHERE sequence = 2").fetchone()
    verified = await asyncio.to_thread(verify, journal)
    expect(not verified.sound and verified.first_bad == 2, f"Verified as {verified}.")
    expect(body == bytes(20), "The row was not changed.")
    words = ("python", "-m", "pcmrs.cli", "journal", "verify", str(journal))
    status, text = await ended([*without_guards("bad_rows_are_no_problem"), *words])
    expect(status == 0, f"Without the guard, too, the journal was not verified: {text[-300:]}")
    return Evidence(
        "found by pcmrs journal verify",
        took_place={"body_of_the_row": body.hex()},
        control_kind="mutant",
        control={"verified_without_the_guard": status == 0, "sound_before": whole.sound},
        details={"first_bad": verified.first_bad, "problems": list(verified.problems)},
    )


@fault(
    "A16",
    how="an older copy of the database in place of the newer one",
    deadline=300.0,
    tries={LOCAL_ACCOUNT: ["journal"]},
)
async def the_journal_is_rolled_back(lab: Lab) -> Evidence:
    """The database is replaced by an older copy; key and head are unchanged."""
    copy = lab.folder / "older.sqlite"
    async with lab.daemon() as cell:
        await accept(cell.client, "registration.reinit")
        journal = Path(cell.ready.journal)
        with closing(sqlite3.connect(journal)) as connection, closing(sqlite3.connect(copy)) as older:
            connection.backup(older)
        for _ in range(5):
            await accept(cell.client, "registration.reinit")
    before = _last(journal)
    inject_unless_sham(lambda: _replace(copy, journal))
    record(LOCAL_ACCOUNT, "journal")
    gone = before - _last(journal)
    text = await _detected(lab, cell, "rolled back")
    prefix = without_guards("acknowledged_rows_are_lost_unseen")
    async with lab.daemon(folder=cell.folder, prefix=prefix) as successor:
        control = await accept(successor.client, "registration.reinit")
    return Evidence(
        DETECTED,
        took_place={"rows_gone": gone},
        control_kind="mutant",
        control={"accepted_without_the_guard": control.decision},
        details={"text": text},
    )


def _replace(database: Path, journal: Path) -> None:
    for beside in journal.parent.glob(f"{journal.name}-*"):
        beside.unlink()
    shutil.copyfile(database, journal)


def _last(journal: Path) -> int:
    with JournalReader(journal) as reader:
        return reader.last_sequence()


@fault(
    "A29",
    how="an accepted verdict added to the database after the daemon has ended",
    deadline=300.0,
    tries={LOCAL_ACCOUNT: ["journal"]},
)
async def rows_are_added_without_the_key(lab: Lab) -> Evidence:
    """A start refuses the row, and names it; the same row is recovered after a crash, with its MAC."""
    whole = lab.folder / "whole.sqlite"
    async with lab.daemon() as cell:
        await accept(cell.client, "registration.reinit")
        journal = Path(cell.ready.journal)
    with JournalReader(journal) as reader:
        end, verdict = reader.last_sequence(), next(reader.read(kind="outcome", last=1)).row
    added = msgspec.structs.replace(verdict, command_id="added")
    shutil.copyfile(journal, whole)
    inject_unless_sham(lambda: append_without_key(journal, [added]))
    record(LOCAL_ACCOUNT, "journal")
    with JournalReader(journal) as reader:
        chained = [stored.sequence for stored in reader.read_whole()]
        found = reader.outcome_of(added.source or "", "added")
    expect(chained[-1:] == [end + 1] and found == added, "The added row is not chained, or not found by its command.")
    text = await _detected(lab, cell, "added to")
    expect(f"row {end + 1} follows the last one" in text, f"The first row that was added is not named: {text}")

    shutil.copyfile(whole, journal)
    append_past_head(journal, [added])
    async with lab.daemon(folder=cell.folder) as successor:
        with JournalReader(Path(successor.ready.journal)) as reader:
            found, noted = (
                reader.outcome_of(added.source or "", "added"),
                next(reader.read(after=end + 1)).row.operation,
            )
    expect((found, noted) == (added, "head_behind"), f"The row of a crash was not recovered: {noted}.")
    return Evidence(
        DETECTED,
        took_place={"chained_row": chained[-1]},
        control_kind="permitted",
        control={"taken_up_after_a_crash": noted},
        details={"text": text},
    )


DETECTED = "refused to start, with the reason"


async def _detected(lab: Lab, cell: RunningCell, how: str) -> str:
    """Return the error of a daemon that refuses to start with a changed journal."""
    status, errors = await lab.start_refused(folder=cell.folder)
    expect(status != 0, f"The daemon accepted the journal that was {how}.")
    text = errors.strip().splitlines()[-1] if errors.strip() else ""
    expect(Path(cell.ready.journal).name in text and "Traceback" not in errors, f"It ended with: {text}")
    return text


async def _answers(raw: Raw, most: int, within: float = PATIENCE) -> list[bytes]:
    """Return up to `most` answers that come within the time, s of the machine."""
    answers: list[bytes] = []
    with suppress(TimeoutError):
        async with asyncio.timeout(within):
            while len(answers) < most:
                answers.append(await raw.answers.get())
    return answers


async def stop_times(
    cell: RunningCell, times: int, press: Callable[[], Awaitable[object]] | None = None
) -> list[float]:
    """Return the times from the request of each Stop until it is answered, s: over the bus, when it has begun.

    Args:
        cell: Cell to stop.
        times: Number of Stops.
        press: Function that presses Stop and waits for the answer; over the bus by default.
    """
    clock = asyncio.get_running_loop().time
    taken = []
    for _ in range(times):
        started = clock()
        await (press or cell.client.stop)()
        taken.append(clock() - started)
        await asyncio.sleep(0.02)
    return taken


def in_ms(name: str, seconds: list[float]) -> dict[str, float]:
    """Return median, p99 and maximum in ms.

    Args:
        name: Prefix of the names.
        seconds: Times, s.
    """
    return {
        f"{name}_p50_ms": round(percentile(seconds, 0.5) * 1e3, 2),
        f"{name}_p99_ms": round(percentile(seconds, 0.99) * 1e3, 2),
        f"{name}_max_ms": round(percentile(seconds, 1.0) * 1e3, 2),
    }
