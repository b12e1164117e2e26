"""Faults of the disk under the journal: full, failing, slow, cut off, or files changed behind the daemon's back."""

from __future__ import annotations

import asyncio
import signal
import sqlite3
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, closing
from functools import partial
from pathlib import Path
from typing import Any

from pcmrs.clock import SystemClock
from pcmrs.messages import Snapshot
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import accept, landmarks
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import loopdisk, syscall_trace, syscalls
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.cuts import CutReport, cut_and_flip, cut_power
from pcmrs_lab.campaign.durable import AnsweredCommands
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.loopdisk import LoopDisk, loop_disk
from pcmrs_lab.campaign.sham import inject_unless_sham
from pcmrs_lab.campaign.syscalls import injected

WRITES = ("pwrite64", "write", "pwritev", "writev")
SYNCS = ("fsync", "fdatasync")
SEVERAL = 300.0
"""Deadline of a fault with several daemons, one after the other, s of the machine."""
COMMANDS = 5
STALL = 2.0
"""Time for which the disk delays a synchronisation, s of the machine."""
POWER_CUTS = 3
NO_LEAST = "journal.least_free_mb=0"
"""Setting with which the daemon refuses nothing before the disk fails."""
IN_TIME = 10.0
"""Time for which commands may be accepted on a disk that is nearly full, s of the machine."""
LEAST_MB = 4
"""Space of a small disk that is kept free, MB."""
UNSYNCHRONISED = bytes(range(256)) * 16
"""Content of a program that does not wait for the disk."""
HALF_WRITTEN = b'{"registration": "111", "landm'
"""Content that a crash can leave of a file."""


@fault("T1", how="a real ext4 disk, full", needs=loopdisk.NEEDS, deadline=SEVERAL)
async def the_disk_is_full(lab: Lab) -> Evidence:
    """All space is taken while the daemon runs, and freed again."""
    async with _daemon_on_disk(lab) as (disk, commands):
        disk.fill()
        error_of_others = disk.error()
        details = await _check_refused_eventually(commands)
        disk.release()
        return await _check_recovery(lab, commands, details, {"another_program_is_told": error_of_others})


@fault("T1", how="a real ext4 disk, nearly full", needs=loopdisk.NEEDS, deadline=SEVERAL)
async def the_disk_is_nearly_full(lab: Lab) -> Evidence:
    """State changes are refused while there is still room for Stop, and the journal never fails."""
    async with _daemon_on_disk(lab, least=f"journal.least_free_mb={LEAST_MB}") as (disk, commands):
        before = disk.used_share()
        disk.fill(leaving=LEAST_MB * 10**6 // 2)
        filled = round(disk.used_share() - before, 3)
        details = await _check_refused_in_time(commands)
        disk.release()
        evidence = await _check_recovery(lab, commands, details, {"share_of_the_disk_taken": filled})
        failed = [row for row in commands.cell.rows() if row.operation == "journal_reopened"]
        expect(not failed, "The journal had to be reopened: the refusal came too late.")
        return evidence


@fault("T1", how="a real ext4 disk with journal and log of the daemon, full", needs=loopdisk.NEEDS, deadline=SEVERAL)
async def the_disk_of_the_log_is_full(lab: Lab) -> Evidence:
    """Log lines are lost; no command fails or waits because of that."""
    async with loop_disk(lab.folder) as disk, lab.daemon(NO_LEAST, folder=disk.path / "cell") as cell:
        commands = await _accepted_commands(cell)
        disk.fill()
        error_of_others = disk.error()
        details = await _check_refused_eventually(commands)
        expect(details["refused_as"] != "no verdict", "A command had no verdict.")
        disk.release()
        return await _check_recovery(lab, commands, details, {"another_program_is_told": error_of_others})


@fault("T2", how="strace: write of the journal's files gives EIO", needs=syscalls.NEEDS, deadline=SEVERAL)
async def writing_fails(lab: Lab) -> Evidence:
    """The disk fails to write."""
    return await _with_failing_calls(lab, WRITES, "EIO")


@fault("T3", how="strace: fsync of the journal's files gives EIO", needs=syscalls.NEEDS, deadline=SEVERAL)
async def synchronising_fails(lab: Lab) -> Evidence:
    """The content of the disk is unknown: nothing is acknowledged until the file was opened and read again."""
    async with lab.daemon() as cell:
        commands = await _accepted_commands(cell)
        async with injected(cell.process.pid, SYNCS, "error=EIO", files=_files(cell)) as tampered:
            details = await commands.degraded()
        expect(await commands.recovers(), "The journal did not recover.")
        reopened = [row for row in cell.rows() if row.operation == "journal_reopened"]
        expect(bool(reopened), "The journal has no row about its recovery.")
    journalled = commands.check_journalled(Path(cell.ready.journal))
    return Evidence(
        "fail-stop; nothing acknowledged is lost",
        {**details, "kept": journalled},
        took_place={"failed_calls": tampered.calls},
        control_kind="without_fault",
        control={"by_the_next_daemon": await _check_successor(lab, cell)},
    )


@fault("T4", how="kill -9, then the end of the write-ahead log is cut within its last frame", deadline=SEVERAL)
async def a_torn_write(lab: Lab) -> Evidence:
    """Acknowledged rows are lost by that, and the next daemon reports it."""
    cell = await _kill_with_rows(lab)
    log = _log_of(cell)
    content = log.read_bytes()
    torn = content[: len(content) - lab.random.randrange(1, 4000)]
    inject_unless_sham(lambda: log.write_bytes(torn))
    return await _check_damage_is_reported(lab, cell, "torn", content)


@fault(
    "T5", how="a real ext4 disk whose file system is cut off without flushing", needs=loopdisk.NEEDS, deadline=SEVERAL
)
async def the_power_is_cut(lab: Lab) -> Evidence:
    """All acknowledged rows are there when the disk is mounted again."""
    journalled, error_of_others, lost = 0, set[str](), 0
    for number in range(POWER_CUTS):
        async with _daemon_on_disk(lab, f"power{number}") as (disk, commands):
            await asyncio.gather(*(commands.request() for _ in range(1 + lab.random.randrange(20))))
            careless = disk.path / "careless"
            careless.write_bytes(UNSYNCHRONISED)
            disk.cut_power()
            error_of_others.add(disk.error())
            await _kill(commands.cell)
            await disk.power_on()
            lost += not careless.exists() or careless.read_bytes() != UNSYNCHRONISED
            journalled += commands.check_journalled(Path(commands.cell.ready.journal))
            await _check_successor(lab, commands.cell)
    return Evidence(
        "acknowledged rows kept",
        {"cuts": POWER_CUTS, "kept": journalled},
        took_place={"another_program_is_told": ", ".join(sorted(error_of_others))},
        control_kind="mutant",
        control={"files_of_a_careless_program_lost": lost},
    )


@fault(
    "T5",
    how="recorded system calls of a writer: synchronised data is kept, and a part of the rest",
    needs=syscall_trace.NEEDS,
)
async def the_power_is_cut_at_any_write(lab: Lab) -> Evidence:
    """The power is cut between any two writes, with torn and reordered sectors."""
    found = await asyncio.to_thread(cut_power, 60, lab.seed, SystemClock())
    expect(not found.violated, f"{found.lost} acknowledged rows are lost; {found.silent[:3]} {found.broken[:3]}")
    careless = await asyncio.to_thread(cut_power, 60, lab.seed, SystemClock(), durable=False)
    expect(careless.violated, "A writer that does not wait for the disk has lost nothing either.")
    return Evidence(
        "acknowledged rows kept",
        took_place={"cuts_that_changed_files": found.changed},
        control_kind="mutant",
        control={"careless_writer_lost_or_broke": careless.lost + len(careless.broken)},
        details={"cuts": found.tried, "acknowledged": found.acknowledged},
    )


@fault("T6", how="bits of the files of a journal are flipped")
async def a_bit_flips(lab: Lab) -> Evidence:
    """Bits of database, write-ahead log and head are flipped at random places."""
    found = await asyncio.to_thread(cut_and_flip, 0, 120, lab.seed, SystemClock())
    expect(not found.violated, f"silent: {found.silent[:3]}; broken: {found.broken[:3]}")
    return _damage_reported("reported, or without effect", found)


@fault("T7", how="the files of a journal are cut")
async def the_tail_is_cut(lab: Lab) -> Evidence:
    """Database, write-ahead log and head are cut at random places."""
    found = await asyncio.to_thread(cut_and_flip, 120, 0, lab.seed, SystemClock())
    expect(not found.violated, f"silent: {found.silent[:3]}; broken: {found.broken[:3]}")
    return _damage_reported("reported, never silent", found)


@fault("T8", how="strace: fsync of the journal's files takes 2 s", needs=syscalls.NEEDS, deadline=SEVERAL)
async def the_disk_stalls(lab: Lab) -> Evidence:
    """Commands wait or are refused; Stop and status do not wait for the disk."""
    async with lab.daemon() as cell:
        commands = await _accepted_commands(cell)
        clock = asyncio.get_running_loop().time
        async with injected(
            cell.process.pid, SYNCS, f"delay_enter={int(STALL * 1e6)}:when=1", files=_files(cell)
        ) as slow:
            asked_at = clock()
            waiting = asyncio.create_task(commands.request())
            await asyncio.sleep(0.2)
            started = clock()
            await cell.client.stop()
            await cell.client.state()
            taken = clock() - started
            expect(not waiting.done(), "A command was answered before the disk was.")
            expect(taken < STALL / 2, f"Stop and status took {taken:.2f} s.")
            verdict = await waiting
            waited = clock() - asked_at
        expect(await commands.recovers(), "Nothing is accepted after the stall.")
    journalled = commands.check_journalled(Path(cell.ready.journal))
    decision = verdict.decision if verdict is not None else "no verdict"
    return Evidence(
        "Stop and status did not wait",
        {"stop_and_status_s": round(taken, 3), "command": decision, "kept": journalled},
        took_place={"delayed_calls": slow.calls, "command_waited_s": round(waited, 3)},
        control_kind="without_fault",
        control={"by_the_next_daemon": await _check_successor(lab, cell)},
    )


@fault("T9", how="a real ext4 disk that goes read-only by itself", needs=loopdisk.NEEDS, deadline=SEVERAL)
async def the_disk_is_read_only(lab: Lab) -> Evidence:
    """The file system becomes read-only, as a damaged one does."""
    async with _daemon_on_disk(lab) as (disk, commands):
        await disk.make_read_only()
        error_of_others = disk.error()
        details = await _check_refused_eventually(commands)
        await _kill(commands.cell)
        await disk.power_on()
        details["kept"] = commands.check_journalled(Path(commands.cell.ready.journal))
        return Evidence(
            "refused; Stop and status work",
            details,
            took_place={"another_program_is_told": error_of_others},
            control_kind="without_fault",
            control={"by_the_next_daemon": await _check_successor(lab, commands.cell)},
        )


@fault("T10", how="half-written files beside the journal and among the records", deadline=SEVERAL)
async def a_half_written_file(lab: Lab) -> Evidence:
    """Half-written files, as a crash can leave them, are not read."""
    async with lab.daemon() as cell:
        await accept(cell.client, "registration.plan_landmarks", **landmarks())
    left = ["lock.tmp", "journal.key.tmp", "ratms.sqlite.head.tmp", "records/placements.csv.tmp", "cache.json"]
    for name in left:
        file = cell.folder / name
        file.parent.mkdir(exist_ok=True)
        inject_unless_sham(partial(file.write_bytes, HALF_WRITTEN))
    async with lab.daemon(folder=cell.folder) as successor:
        snapshot = await successor.client.state()
        await accept(successor.client, "registration.plan_landmarks", **landmarks())
        found = sum(map(partial(_shows_half_a_file, successor), left))
    _expect_initial(snapshot)
    key = cell.folder / "journal.key"
    key.write_bytes(HALF_WRITTEN)
    status, _ = await lab.start_refused(folder=cell.folder)
    expect(status != 0, "A half-written file is not noticed even if it is read.")
    return Evidence(
        "ignored",
        {"files": left},
        took_place={"half_written_files_where_the_daemon_reads": found},
        control_kind="permitted",
        control={"exit_status_with_such_a_key": status},
    )


def _shows_half_a_file(cell: RunningCell, name: str) -> bool:
    """Return whether a running daemon would read the half-written content under a name in its folder.

    The kernel shows its view of the file system: its root, and its folder below that.
    """
    seen = Path(f"/proc/{cell.process.pid}/root{cell.folder.resolve()}") / name
    return seen.is_file() and seen.read_bytes() == HALF_WRITTEN


@fault("T11", how="kill -9, then the write-ahead log is deleted", deadline=SEVERAL)
async def the_log_is_lost(lab: Lab) -> Evidence:
    """Rows that were only in the log are missing, and the next daemon reports it."""
    cell = await _kill_with_rows(lab)
    log = _log_of(cell)
    content = log.read_bytes()
    inject_unless_sham(log.unlink)
    return await _check_damage_is_reported(lab, cell, "lost", content)


@fault("T12", how="another program holds the lock of the database", deadline=SEVERAL)
async def a_foreign_lock(lab: Lab) -> Evidence:
    """A backup program, or a user of the sqlite3 command, holds the lock."""
    async with lab.daemon() as cell:
        commands = await _accepted_commands(cell)
        with closing(sqlite3.connect(cell.ready.journal, isolation_level=None)) as foreign:
            inject_unless_sham(lambda: foreign.execute("BEGIN IMMEDIATE"))
            error_of_others = _lock_error(Path(cell.ready.journal))
            details = await _check_refused_eventually(commands)
            foreign.execute("ROLLBACK")
        return await _check_recovery(lab, commands, details, {"a_third_program_is_told": error_of_others})


@asynccontextmanager
async def _daemon_on_disk(
    lab: Lab, name: str = "mounted", least: str = NO_LEAST
) -> AsyncIterator[tuple[LoopDisk, AnsweredCommands]]:
    """Start a daemon whose folder is on its own disk, with some rows in its journal."""
    place = lab.folder / name
    place.mkdir()
    async with loop_disk(place) as disk, lab.daemon(f"cell.folder={disk.path}", least, folder=place) as cell:
        yield disk, await _accepted_commands(cell)
        await _kill(cell)


async def _accepted_commands(cell: RunningCell) -> AnsweredCommands:
    commands = AnsweredCommands(cell)
    for _ in range(COMMANDS):
        verdict = await commands.request("registration.plan_landmarks", **landmarks())
        expect(verdict is not None and verdict.decision == "accepted", f"{verdict} before the fault.")
    return commands


async def _with_failing_calls(lab: Lab, calls: Sequence[str], error: str) -> Evidence:
    async with lab.daemon() as cell:
        commands = await _accepted_commands(cell)
        async with injected(cell.process.pid, calls, f"error={error}", files=_files(cell)) as tampered:
            details = await _check_refused_eventually(commands)
        return await _check_recovery(lab, commands, details, {"failed_calls": tampered.calls})


def _damage_reported(response: str, found: CutReport) -> Evidence:
    """Return the evidence that damaged files were reported, and undamaged ones recovered."""
    return Evidence(
        response,
        took_place={"changed": found.changed, "reported": found.reported},
        control_kind="without_fault",
        control={"undamaged_taken_up": found.whole},
        details={"tried": found.tried, "unaffected": found.unaffected},
    )


async def _check_refused_eventually(commands: AnsweredCommands) -> dict[str, object]:
    """Check response D; a command or two may still fit into space that is already allocated."""
    for _ in range(40):
        verdict = await commands.request("registration.plan_landmarks", **landmarks())
        if verdict is None or verdict.decision != "accepted":
            return await commands.degraded()
    raise Unmet("Forty commands were accepted although nothing can be written.")


async def _check_refused_in_time(commands: AnsweredCommands) -> dict[str, object]:
    """Check response D, by the watch of the free space, which checks every second."""
    clock = asyncio.get_running_loop().time
    end = clock() + IN_TIME
    while clock() < end:
        verdict = await commands.request("registration.plan_landmarks", **landmarks())
        if verdict is not None and verdict.reason is not None and verdict.reason.code == "disk_full":
            return await commands.degraded()
        await asyncio.sleep(0.05)
    raise Unmet(f"Commands were accepted for {IN_TIME:g} s although the disk is nearly full.")


async def _check_recovery(
    lab: Lab, commands: AnsweredCommands, details: dict[str, object], took_place: Mapping[str, Any]
) -> Evidence:
    """Check that after the fault the daemon, or its successor, continues, and nothing acknowledged is lost."""
    cell = commands.cell
    details["recovered"] = await commands.recovers(5.0)
    await _kill(cell)
    details["kept"] = commands.check_journalled(Path(cell.ready.journal))
    return Evidence(
        "refused; Stop and status work; nothing lost",
        dict(details),
        took_place=took_place,
        control_kind="without_fault",
        control={"by_the_next_daemon": await _check_successor(lab, cell)},
    )


async def _check_successor(lab: Lab, cell: RunningCell) -> str:
    """Check that the next daemon on the folder starts as usual and decides again; return its decision."""
    async with lab.daemon(f"cell.folder={cell.ready.folder}", NO_LEAST, folder=cell.folder) as successor:
        _expect_initial(await successor.client.state())
        verdict = await accept(successor.client, "registration.plan_landmarks", **landmarks())
    return verdict.decision


def _expect_initial(snapshot: Snapshot) -> None:
    expect(snapshot.branches["registration"] == "000", f"The next daemon begins in {snapshot.branches}.")


async def _kill(cell: RunningCell) -> None:
    if cell.process.returncode is None:
        cell.process.send_signal(signal.SIGKILL)
        await cell.process.wait()


async def _kill_with_rows(lab: Lab) -> RunningCell:
    async with lab.daemon() as cell:
        await _accepted_commands(cell)
        await _kill(cell)
    expect(_log_of(cell).exists(), "The daemon left no write-ahead log.")
    return cell


async def _check_damage_is_reported(lab: Lab, cell: RunningCell, how: str, log: bytes) -> Evidence:
    """Check that the next daemon refuses to start with the reason, and starts with the original write-ahead log."""
    path = _log_of(cell)
    lost = len(log) - (path.stat().st_size if path.exists() else 0)
    expect(lost > 0, "The write-ahead log has lost nothing.")
    status, errors = await lab.start_refused(folder=cell.folder)
    text = errors.strip().splitlines()[-1] if errors.strip() else ""
    expect(status != 0 and "Traceback" not in errors, f"Exit status {status}: {errors[-2000:]}")
    expect("journal" in text or "sqlite" in text, f"It ended with: {text}")
    path.write_bytes(log)
    return Evidence(
        f"{how}: refused to start, with the reason",
        {"status": status, "text": text},
        took_place={"bytes_lost": lost},
        control_kind="without_fault",
        control={"with_the_whole_log": await _check_successor(lab, cell)},
    )


def _lock_error(journal: Path) -> str:
    """Return the error of another program that requests the lock of the database; empty if it gets it."""
    with closing(sqlite3.connect(journal, timeout=0.0, isolation_level=None)) as third:
        try:
            third.execute("BEGIN IMMEDIATE")
        except sqlite3.OperationalError as error:
            return str(error)
        third.execute("ROLLBACK")
    return ""


def _files(cell: RunningCell) -> list[Path]:
    """Return the files of the journal."""
    journal = Path(cell.ready.journal)
    return [journal, *(journal.with_name(journal.name + ending) for ending in ("-wal", ".head"))]


def _log_of(cell: RunningCell) -> Path:
    return _files(cell)[1]
