"""Deliberate attacks that need no access control: floods, magic texts, forged files."""

from __future__ import annotations

import asyncio
import json
import shutil
import sqlite3
import sys
from collections.abc import Awaitable, Callable, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import msgspec

from pcmrs.console.planning.importer import PointsRequest, Refused
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.gateway.auth.peers import FRESH_FOR
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.gateway.tcp import MOST_OF_A_HOST
from pcmrs.journal import JournalReader, verify
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
from pcmrs_lab.campaign.checks import confirmed, expect, held, refused, refused_at_edge, reported, shape, unmoved
from pcmrs_lab.campaign.damage import append_past_head, append_without_key
from pcmrs_lab.campaign.datagrams import Raw, raw_socket, refused_all, send_accepted
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.flood import flood
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.lateness import percentile, timer_lateness
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham
from pcmrs_lab.campaign.stop_limits import exceeded
from pcmrs_lab.campaign.tries import COMMANDS, DELAYED, FLOODING, LOCAL_ACCOUNT, UNKNOWN, record

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
file = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT)
acts = ((socket.socket,), (subprocess.run, ["true"]), (bytes, 2**31), (os.write, file, b"x"))
def taken_over(path):
    said = []
    for act, *words in acts[: int(sys.argv[3])]:
        try:
            act(*words)
            said.append("done")
        except (OSError, MemoryError) as error:
            said.append(type(error).__name__)
    raise PcmrsError(" ".join(said))
importer.read_points = taken_over
if sys.argv[1] == "free":
    importer.confine = lambda memory, seconds: None
importer.main()
"""
"""Actions that a malicious file could make its reader perform."""


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
        control=in_ms("stop_without_flood", quiet),
        details=details,
    )


@fault("A5", how="raw datagrams", tries={UNKNOWN: ["UDP"]})
async def magic_texts(lab: Lab) -> Evidence:
    """Texts that might close a receiver are refused, alone and as a part of a datagram."""
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        details = await refused_all(cell, [*MAGIC, *(b"x" * 16 + m for m in MAGIC)])
        control = await send_accepted(cell, b"stop_visualizexx_#1;")
    return Evidence(
        "refused, the receiver continues",
        took_place={"refused_in_the_journal": details.pop("refused")},
        control={"a_command_instead": control},
        details=details,
    )


@fault("A6", how="raw datagrams and requests on the bus", tries={UNKNOWN: ["UDP"], LOCAL_ACCOUNT: [COMMANDS]})
async def unknown_commands_and_bad_numbers(lab: Lab) -> Evidence:
    """Unknown commands, and invalid indices and numbers, are refused."""
    wrong = [b"no_such_commandx;", b"img_fid_numxxxxx_-1;", b"img_fid_numxxxxx_1000;", b"img_dig_digitize_x;"]
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
        control = await right_numbers(cell, details)
        planned = await accept(cell.client, "toolplan.plan", **tool_pose())
    return Evidence(
        "refused, nothing changed",
        took_place={"refused_in_the_journal": details.pop("refused")},
        control={"right_number": control, "right_plan": planned.decision},
        details=details,
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
        control = await right_numbers(cell, details)
        planned = await accept(cell.client, "toolplan.plan", **tool_pose())
    return Evidence(
        "refused, nothing changed",
        took_place={"refused_in_the_journal": details.pop("refused"), "malformed_on_the_bus": malformed},
        control={"right_number": control, "right_plan": planned.decision},
        details=details,
    )


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
    reasons = [verdict.reason.code for verdict in decided if verdict.reason]
    expect(reasons == ["unknown_surface"] * len(paths), f"They were refused for {reasons}.")
    accepted = [path for path, verdict in verdicts.items() if verdict.decision == "accepted"]
    expect(not accepted, f"{accepted} were accepted.")
    expect(shape(before) == shape(after), f"The state has changed: {before} became {after}.")
    expect(not new, f"Files were created: {new}.")
    return Evidence(
        "refused, no file was touched",
        took_place={"refused_in_the_journal": reasons},
        control={"configured_surface": control.decision},
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
        control={"approach_without_stop": alone.decision},
        details={"sent": SPAM, "honoured": honoured},
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
    return Evidence(
        "ended at the first wrong byte",
        took_place={"malformed_in_the_journal": malformed},
        control={"the_command_by_itself": control.decode()},
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
    return Evidence(
        "bounded, and Stop works",
        took_place={"turned_away_in_the_journal": rejected},
        control={"one_more_when_they_are_closed": control.decode()},
        details={"connections": SILENT},
    )


@fault(
    "A25",
    how="a signed command that is delayed; from a peer with the time in its counters, and from one without",
    tries={DELAYED: ["UDP"]},
)
async def held_back(lab: Lab) -> Evidence:
    """An attacker on the route delays a datagram, and delivers it long after it was sent."""
    command, peers, settings = b"rob_conn_onxxxxx_#1;", {}, []
    for name, counter in (("timed", "unix_ns"), ("growing", "growing")):
        key = lab.folder / f"{name}.key"
        new_key(key)
        peers[name] = Signer(name, read_key(key))
        table = {"key_file": str(key), "counter": counter, "role": "operator", "allow": ["robot"]}
        settings += [f"gateway.peers.{name}.{setting}={json.dumps(value)}" for setting, value in table.items()]
    async with lab.daemon(*settings) as cell, raw_socket(cell.ready.links["planner"]) as raw:
        held = {name: signer.sign(command) for name, signer in peers.items()}
        if not is_sham():
            await asyncio.sleep(FRESH_FOR + 0.5)
        row = cell.last_row()
        async with unmoved(cell):
            (answer,) = await _send_and_receive(raw, held["timed"])
            record(DELAYED, "UDP")
            too_old = await reported(cell, row, edge="gateway", code="too_old", count=1)
        expect(b"_rejected_" in answer and b"too_old;" in answer, f"The peer with the time was answered {answer!r}.")
        (control,) = await _send_and_receive(raw, held["growing"])
        expect(b"_accepted_" in control, f"The peer without the time was answered {control!r}.")
        (fresh,) = await _send_and_receive(raw, peers["timed"].sign(b"rob_conn_offxxxx_#2;"))
        expect(b"_accepted_" in peers["timed"].check(fresh), f"A fresh command was answered {fresh!r}.")
    return Evidence(
        "refused as too old",
        took_place={"too_old_in_the_journal": too_old},
        control={"without_the_time": control.decode(), "fresh": fresh.decode()},
        details={"answer": answer.decode()},
    )


@fault(
    "A26",
    how="the program that reads uploaded files, its parser taken over, with its limits and without",
    tries={LOCAL_ACCOUNT: ["uploads"]},
)
async def a_reader_is_taken_over(lab: Lab) -> Evidence:
    """A file makes its reader try to open a connection, start a program, take memory and write."""
    tries, pipe = {}, asyncio.subprocess.PIPE
    request = msgspec.msgpack.encode(PointsRequest("patient.json", memory=2**30, seconds=60))
    for how in ("confined", "free"):
        words = (sys.executable, "-c", TAKEN_OVER, how, str(lab.folder / how), "0" if is_sham() else "4")
        process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)
        answer, _ = await process.communicate(request)
        record(LOCAL_ACCOUNT, "uploads")
        tries[how] = msgspec.msgpack.decode(answer, type=Refused).text.split()
    expect(
        tries["free"] == ["done"] * 4, f"Without limits the results were {tries['free']}: the attack did not happen."
    )
    expect(
        len(tries["confined"]) == 4 and "done" not in tries["confined"],
        f"With limits the results were {tries['confined']}.",
    )
    written = {how: (lab.folder / how).stat().st_size for how in tries}
    expect(written == {"confined": 0, "free": 1}, f"Bytes were written: {written}.")
    return Evidence(
        "each is refused by the kernel",
        took_place={"refused_by_the_kernel": tries["confined"]},
        control={"without_limits": tries["free"], "bytes_written": written["free"]},
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
    return Evidence(
        "found by pcmrs journal verify",
        took_place={"body_of_the_row": body.hex()},
        control={"sound_before": whole.sound},
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
    whole = lab.folder / "whole.sqlite"
    with closing(sqlite3.connect(journal)) as connection, closing(sqlite3.connect(whole)) as kept:
        connection.backup(kept)
    before = _last(journal)
    inject_unless_sham(lambda: _replace(copy, journal))
    record(LOCAL_ACCOUNT, "journal")
    gone = before - _last(journal)
    text = await _detected(lab, cell, "rolled back")
    _replace(whole, journal)
    async with lab.daemon(folder=cell.folder) as successor:
        control = await accept(successor.client, "registration.reinit")
    return Evidence(
        DETECTED,
        took_place={"rows_gone": gone},
        control={"accepted_with_the_newer_one": control.decision},
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


async def _answers(raw: Raw, most: int) -> list[bytes]:
    """Return up to `most` answers that come within `PATIENCE`."""
    answers: list[bytes] = []
    with suppress(TimeoutError):
        async with asyncio.timeout(PATIENCE):
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
