"""Pulses, hot-spot and threshold of a session are those of its journal."""

from __future__ import annotations

import msgspec
import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.report.session_journal import SessionJournal
from pcmrs.report.stimulation.reading import PHASES, StimulationSession
from pcmrs.workflows.tms.data import Response
from tests.support.session_records import record
from tests.unit.report.report_journals import Row, golden_rows

ROWS = golden_rows("ratms_threshold")


def session(rows: list[Row]) -> StimulationSession:
    stored = [
        StoredRow(sequence=number, row=msgspec.convert(row, JournalRow), previous_hash=b"", hash=b"")
        for number, row in enumerate(rows, 1)
    ]
    return StimulationSession(SessionJournal(stored))


def accepted(*names: str) -> list[Row]:
    return [
        row
        for row in ROWS
        if row["kind"] == "outcome"
        and row["verdict"]["decision"] == "accepted"
        and f"{row['branch']}.{row['operation']}" in names
    ]


def pulse_rows() -> list[Row]:
    """The pulses of a record as outcomes in a journal, after the first row of the golden session."""
    template = accepted("placement.confirm")[0]
    operations = {phase: operation for operation, phase in PHASES.items()}
    rows = [ROWS[0]]
    for pulse in record().pulses:
        branch, operation = operations[pulse.phase].split(".")
        fields = ("pulse", "intensity", "coil", "error_mm", "error_deg", "mep", "problem", "problem_text")
        response = Response(**{name: getattr(pulse, name) for name in fields})
        data = {"response": response, "epoch": pulse.epoch, "last_pulse": ROWS[0]["monotonic"] + pulse.onset}
        verdict = template["verdict"] | {"branch": branch, "operation": operation}
        named = {"branch": branch, "operation": operation, "wall": pulse.wall, "command_id": f"p{pulse.pulse}"}
        rows.append({**template, **named, "verdict": verdict, "result": msgspec.to_builtins(data)})
    return rows


def test_every_pulse_is_read_as_it_was_given() -> None:
    """Round trip: a record as rows of a journal, read back."""
    found = session(pulse_rows()).pulses()
    assert len(found) == len(record().pulses)
    for pulse, given in zip(found, record().pulses, strict=True):
        assert pulse.onset == pytest.approx(given.onset)
        assert msgspec.structs.replace(pulse, onset=given.onset) == given


def test_a_pulse_that_was_refused_is_not_one() -> None:
    rows = pulse_rows()
    rows[2] = rows[2] | {"verdict": rows[2]["verdict"] | {"decision": "failed"}}
    assert [pulse.pulse for pulse in session(rows).pulses()] == [1, *range(3, len(rows))]


def test_placements_have_the_error_predicted_for_their_plan() -> None:
    rows, placements = accepted("placement.confirm"), session(ROWS).placements()
    assert len(placements) == len(rows) > 0
    for placement, row in zip(placements, rows, strict=True):
        assert placement.error_mm == pytest.approx(1e3 * row["verdict"]["result"]["translation_error"])
        plans = [each for each in accepted("toolplan.plan", "toolplan.aim_hotspot") if each["wall"] <= row["wall"]]
        tre = plans[-1]["verdict"]["result"].get("tre")
        assert placement.tre_mm == (None if tre is None else pytest.approx(1e3 * tre))


def test_ceiling_and_registration_are_the_last_ones() -> None:
    found = session(ROWS)
    given = accepted("stimulation.set_ceiling")[-1]["arguments"]
    assert found.ceiling() == (given["percent"], given["operator"])
    reported = accepted("registration.register")[-1]["verdict"]["result"]
    registration = found.registration()
    assert registration is not None
    assert registration.distances_mm == pytest.approx([1e3 * distance for distance in reported["distances"]])
    assert len(registration.landmarks) == len(reported["distances"])
    assert registration.limit_mm == pytest.approx(1e3 * reported["limit"])


def test_repeated_refusals_are_one_and_unfinished_are_listed() -> None:
    (refused,) = [row for row in ROWS if row["kind"] == "outcome" and row["verdict"]["decision"] == "rejected"][:1]
    intent = {**next(row for row in ROWS if row["kind"] == "intent"), "command_id": "never ended"}
    *repeated, unfinished = session([ROWS[0], refused, refused, refused, intent]).refusals()
    assert [(each.times, each.code) for each in repeated] == [(3, refused["verdict"]["reason"]["code"])]
    assert (unfinished.code, unfinished.decision) == ("no_outcome", "unknown")
    assert unfinished.operation == f"{intent['branch']}.{intent['operation']}"


def test_refusals_in_a_row_are_one_only_if_they_are_alike() -> None:
    refused = next(row for row in ROWS if row["kind"] == "outcome" and row["verdict"]["decision"] == "rejected")
    failed = refused | {"verdict": refused["verdict"] | {"decision": "failed"}}
    found = session([ROWS[0], refused, refused, failed, refused]).refusals()
    assert [(each.decision, each.times) for each in found] == [("rejected", 2), ("failed", 1), ("rejected", 1)]


def test_a_session_in_which_nothing_was_done_has_no_results() -> None:
    found = session(ROWS[:1])
    assert (found.pulses(), found.placements(), found.refusals()) == ((), (), ())
    assert (found.registration(), found.ceiling(), found.search(), found.hunt()) == (None, None, None, None)
    assert (found.hotspot(), found.threshold(), found.duration) == (None, None, 0.0)
    with pytest.raises(JournalError, match="nothing was done"):
        session([])
