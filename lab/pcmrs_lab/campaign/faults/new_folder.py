"""A cell with a new folder has no counters of its signed peers: it accepts their earlier messages once more."""

from __future__ import annotations

from pcmrs.gateway.links import RESET
from pcmrs.gateway.signing import Signer, new_key, read_key
from pcmrs.testing.cell import RunningCell
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.datagrams import raw_socket, refusals_after, send_accepted
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import DELAYED, record
from pcmrs_lab.campaign.waiting import until_true


@fault(
    "A36",
    how="a signed command that was accepted, sent again to daemons in the same and in a new folder",
    deadline=240.0,
    tries={DELAYED: ["UDP"]},
)
async def counters_are_gone(lab: Lab) -> Evidence:
    """In a new folder the daemon reports that before it accepts anything; in the same one it refuses."""
    key = lab.folder / "slicer.key"
    new_key(key)
    peer = f"gateway.peers.slicer.key_file={key}"
    old, new = lab.folder / "old", lab.folder / "new"
    command = Signer("slicer", read_key(key), lambda: 1).sign(b"img_fid_numxxxxx_4_#1;")
    async with lab.daemon(peer, folder=old) as cell:
        first = await send_accepted(cell, command)
        row, reports_before = cell.last_row(), cell.log.count(RESET)
    async with lab.daemon(peer, folder=old) as cell:
        refused = await _refused(cell, command)
        expect(
            not _reports(cell, row) and cell.log.count(RESET) == reports_before,
            "It reports counters as lost that it still has.",
        )
    async with lab.daemon(peer, folder=old if is_sham() else new) as cell:
        reports = _reports(cell, 0)
        answer = await send_accepted(cell, command)
        record(DELAYED, "UDP")
        expect(len(reports) == 1 and "slicer" in reports[0], f"At the start the journal reports {reports}.")
        expect(cell.log.count(RESET) == 1, "The log does not report it once.")
    return Evidence(
        "reported at the start, in log and journal",
        took_place={"taken_once_more": answer},
        control_kind="permitted",
        control={"taken_when_it_was_sent": first, "refused_with_its_counters": refused},
        details={"text": reports[0]},
    )


async def _refused(cell: RunningCell, command: bytes) -> int:
    """Check that a repeated command is refused and not answered, and return the number of refusals in the journal."""
    row = cell.last_row()
    async with raw_socket(cell.ready.links["planner"]) as raw:
        raw.send(command)
        await until_true(lambda: refusals_after(cell, row) > 0, "The journal has no refusal of the repeated command")
        expect(raw.answers.empty(), "The repeated command is answered.")
    return refusals_after(cell, row)


def _reports(cell: RunningCell, after: int) -> list[str]:
    """Return the texts of later rows that report counters at 0."""
    return [str((row.result or {})["text"]) for row in cell.rows(after) if row.operation == RESET]
