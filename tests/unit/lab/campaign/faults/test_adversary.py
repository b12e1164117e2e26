"""Rows of attacks: forged files are found or refused, paths and numbers are not believed, every Stop counts."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.console.planning.importer import RefusalAnswer
from pcmrs.dispatcher.events import PRESSED_AGAIN
from pcmrs.journal import Journal
from pcmrs.messages import Verdict
from pcmrs.planner import PlannerVerdict
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.fault import Evidence
from pcmrs_lab.campaign.faults import adversary
from pcmrs_lab.campaign.faults.adversary import ACTS, SPAM
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.faults.operated import OperatedCell, lab_of, proves, run
from tests.unit.lab.campaign.faults.scripted_raw import ScriptedRaw
from tests.unit.lab.campaign.scripted_cell import ScriptedLab
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started
from tests.unit.lab.scripted_client import row, verdict


def test_times_are_shown_in_ms() -> None:
    seconds = [0.001 * number for number in range(1, 101)]
    assert adversary.in_ms("stop", seconds) == {"stop_p50_ms": 50.0, "stop_p99_ms": 99.0, "stop_max_ms": 100.0}


def test_each_stop_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()

    async def stop() -> None:
        await asyncio.sleep(0.25)

    monkeypatch.setattr(cell.client, "stop", stop)
    assert run(monkeypatch, adversary.stop_times(cell.as_cell, 3)) == pytest.approx([0.25] * 3)


async def test_wrong_numbers_must_be_refused_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    async def send(_: Any, *commands: bytes) -> str:
        return f"{len(commands)}_accepted"

    monkeypatch.setattr(adversary, "send_accepted", send)
    assert await adversary.right_numbers(OperatedCell().as_cell, {"reasons": ["malformed"]}) == "2_accepted"
    with pytest.raises(Unmet, match="no_rotation"):
        await adversary.right_numbers(OperatedCell().as_cell, {"reasons": ["malformed", "no_rotation"]})


def test_answers_are_waited_for_but_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    async def ask() -> tuple[list[bytes], list[bytes]]:
        raw = ScriptedRaw(OperatedCell())
        raw.takes = lambda datagram: datagram
        raw.send(b"1")
        few = await adversary._answers(raw, 2)  # type: ignore[arg-type]
        for number in (b"2", b"3", b"4"):
            raw.send(number)
        return few, await adversary._answers(raw, 2)  # type: ignore[arg-type]

    assert run(monkeypatch, ask()) == ([b"1"], [b"2", b"3"])


class Journalled(OperatedCell):
    """A cell with a real journal, to which each accepted command adds a row; closed as a daemon closes it."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder / "cell1")
        (folder / "cell1").mkdir()
        self.journal: Journal | None = None
        call = self.client.call

        async def record(name: str, arguments: Any = None, **more: Any) -> Verdict:
            decided = await call(name, arguments, **more)
            assert self.journal is not None
            await self.journal.append([row(verdict=decided)])
            return decided

        self.client.call = record  # type: ignore[method-assign]


class Journals(ScriptedLab):
    """A lab of such a cell, whose daemon refuses a changed journal with this."""

    def __init__(self, folder: Path, refusal: tuple[int, str] = (4, "Error: ratms.sqlite was changed.\n")) -> None:
        self.own = Journalled(folder)
        super().__init__(folder, self.own)
        self.refusals = [refusal]

    @asynccontextmanager
    async def daemon(self, *overrides: str, prefix: Sequence[str] = (), **_: Any) -> AsyncIterator[OperatedCell]:
        if prefix:  # without the guard that keeps a real one from opening this journal
            yield OperatedCell()
            return
        self.own.journal = Journal.open(Path(self.own.ready.journal))
        await self.own.journal.append([row("config"), row("snapshot")])
        yield self.own
        await self.own.journal.close()


def ran(row_of: Any, lab: ScriptedLab) -> Evidence:
    found: Evidence = asyncio.run(row_of(lab.as_lab))
    return found


def test_an_edited_row_is_found_by_verifying(tmp_path: Path) -> None:
    found = ran(adversary.the_journal_is_edited, Journals(tmp_path))
    assert proves(found)
    assert found.took_place == {"body_of_the_row": "00" * 20}
    assert found.details["first_bad"] == 2


def test_a_row_that_was_not_edited_is_found_out(tmp_path: Path) -> None:
    with sham(), pytest.raises(Unmet, match="Verified as"):
        ran(adversary.the_journal_is_edited, Journals(tmp_path))


def test_an_older_copy_is_refused(tmp_path: Path) -> None:
    found = ran(adversary.the_journal_is_rolled_back, Journals(tmp_path))
    assert proves(found)
    assert found.took_place["rows_gone"] >= 5
    assert found.control == {"accepted_without_the_guard": "accepted"}


def test_a_journal_that_is_as_new_proves_nothing(tmp_path: Path) -> None:
    with sham():
        assert "rows_gone" in ran(adversary.the_journal_is_rolled_back, Journals(tmp_path)).missing("order")


@pytest.mark.parametrize(
    ("status", "errors", "text"),
    [
        (0, "", "The daemon accepted the journal that was edited"),
        (4, "Traceback\nratms.sqlite", "It ended with: ratms.sqlite"),
        (4, "Error: the disk is full.", "It ended with: Error: the disk is full"),
        (4, "", "It ended with: "),
    ],
)
async def test_a_changed_journal_is_refused_by_name(tmp_path: Path, status: int, errors: str, text: str) -> None:
    lab = ScriptedLab(tmp_path, OperatedCell())
    lab.refusals = [(status, errors), (4, "log\nError: ratms.sqlite was changed.\n")]
    with pytest.raises(Unmet, match=text):
        await adversary._detected(lab.as_lab, lab.cells[0].as_cell, "edited")
    assert await adversary._detected(lab.as_lab, lab.cells[0].as_cell, "edited") == "Error: ratms.sqlite was changed."


def test_nothing_of_a_newer_database_is_left_beside_an_older(tmp_path: Path) -> None:
    journal, older = tmp_path / "ratms.sqlite", tmp_path / "older"
    older.write_bytes(b"older")
    for name in ("ratms.sqlite", "ratms.sqlite-wal", "ratms.sqlite-shm", "ratms.sqlite.head"):
        (tmp_path / name).write_bytes(b"newer")
    adversary._replace(older, journal)
    assert journal.read_bytes() == b"older"
    assert {path.name for path in tmp_path.iterdir()} == {"older", "ratms.sqlite", "ratms.sqlite.head"}


@pytest.fixture
def raw(monkeypatch: pytest.MonkeyPatch) -> ScriptedRaw:
    made = ScriptedRaw(OperatedCell())
    monkeypatch.setattr(adversary, "raw_socket", made.open)
    return made


def honours(raw: ScriptedRaw, *, uncounted: int = 0) -> OperatedCell:
    cell = raw.cell
    assert isinstance(cell, OperatedCell)

    def take(datagram: bytes) -> bytes:
        if not cell.client.latched:
            cell.client.hold()
            cell.client.rows.append(row("device", operation="stopped"))
        if len(raw.sent) == SPAM:
            joined = {"fields": {"presses": SPAM - 1 - uncounted}}
            cell.client.rows.append(row("device", operation=PRESSED_AGAIN, result=joined))
        return datagram.partition(b"#")[2].rstrip(b";") + b"_accepted_stop;"

    raw.takes = take
    return cell


def test_thousands_of_stops_are_all_honoured(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, raw: ScriptedRaw) -> None:
    cell = honours(raw)
    monkeypatch.setattr(adversary, "reset_cell", _nothing)
    found = run(monkeypatch, adversary.stop_spam(lab_of(tmp_path, cell)))
    assert proves(found)
    assert found.took_place == {"counted_in_the_journal": SPAM}


async def _nothing(_: Any) -> None:
    pass


def test_stops_that_the_journal_does_not_count_are_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, raw: ScriptedRaw
) -> None:
    cell = honours(raw, uncounted=1)
    with pytest.raises(Unmet, match=f"the journal counts {SPAM - 1}"):
        run(monkeypatch, adversary.stop_spam(lab_of(tmp_path, cell)))


def test_stops_that_are_not_answered_are_unmet(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, raw: ScriptedRaw
) -> None:
    cell = honours(raw)
    with sham(), pytest.raises(Unmet, match=f"Of {adversary.BATCH} Stops 0 were answered"):
        run(monkeypatch, adversary.stop_spam(lab_of(tmp_path, cell)))


def paths(cell: OperatedCell, code: str = "unknown_surface", decision: Any = "rejected") -> None:
    """A daemon that decides on paths to surfaces like this."""

    async def command(name: str, path: str, timeout: float = 0.0) -> PlannerVerdict:
        if path.endswith("head_phantom.ply"):
            return PlannerVerdict("accepted", "registration", "111", None, ())
        cell.client.rows.append(row(verdict=verdict("registration.refine", decision, code)))
        return PlannerVerdict(decision, "registration", "110", code, ())

    cell.planner.command = command  # type: ignore[method-assign, assignment]


@pytest.mark.parametrize(
    ("code", "decision", "text"),
    [
        ("unknown_surface", "rejected", ""),
        ("busy", "rejected", "refused for"),
        ("unknown_surface", "accepted", "were accepted"),
    ],
)
def test_paths_name_configured_surfaces_only(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: str, decision: Any, text: str
) -> None:
    cell = OperatedCell(tmp_path / "cell1")
    (tmp_path / "cell1").mkdir()
    paths(cell, code, decision)
    work = adversary.paths_from_the_network(lab_of(tmp_path, cell))
    if text:
        with pytest.raises(Unmet, match=text):
            run(monkeypatch, work)
        return
    found = run(monkeypatch, work)
    assert proves(found)
    assert found.took_place == {"refused_in_the_journal": [code] * 5}


def taken_over(
    monkeypatch: pytest.MonkeyPatch, folder: Path, confined: str, free: str, damaged: bool = False
) -> Evidence:
    """Evidence of a reader that said this of what it tried."""
    children = []
    folder.mkdir()
    for how, said, acts in (("confined", confined, damaged), ("free", free, True)):
        child = ScriptedChild()
        answer = msgspec.msgpack.encode(RefusalAnswer(said))

        async def communicate(
            _: bytes, answer: bytes = answer, place: Path = folder / how, acts: bool = acts
        ) -> tuple[bytes, bytes]:
            if acts:
                (place / "removed").unlink()
                (place / "emptied").write_text("")
                (place / "written").write_text("xritten")
            return answer, b""

        monkeypatch.setattr(child, "communicate", communicate)
        children.append(child)
    started(monkeypatch, *children)

    async def judge() -> Evidence:
        return await adversary.a_reader_is_taken_over(lab_of(folder, OperatedCell()))

    return asyncio.run(judge())


KEPT, DONE = " ".join(["PermissionError"] * ACTS), " ".join(["done"] * ACTS)


def test_a_reader_may_do_nothing_but_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = taken_over(monkeypatch, tmp_path / "found", KEPT, DONE)
    assert proves(found)
    assert found.control["files"] == {"emptied": "", "written": "xritten"}
    for number, (confined, free, damaged, text) in enumerate(
        (
            (DONE, DONE, False, "With limits the results were"),
            (KEPT.replace("PermissionError", "done", 1), DONE, False, "With limits the results were"),
            (KEPT, KEPT, False, "the attack did not happen"),
            ("", "", False, "the attack did not happen"),
            (KEPT, DONE, True, "The files are"),
        )
    ):
        with pytest.raises(Unmet, match=text):
            taken_over(monkeypatch, tmp_path / str(number), confined, free, damaged)
