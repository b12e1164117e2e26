"""Commands print text of other people without any effect on the terminal, and no such text forges a line."""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout, suppress
from types import SimpleNamespace
from typing import Any, cast

import click
import pyarrow as pa
import pytest
from hypothesis import example, given
from msgspec.structs import replace

from pcmrs.archive import ArchiveVerification
from pcmrs.cli import archive, cell, doctor, export_session, journal, journal_replay, playback, recording, register
from pcmrs.cli.fsm import files, simulate
from pcmrs.cli.health import health_table
from pcmrs.cli.log import log_standard_library
from pcmrs.cli.printing import say, say_json, say_lines, write_document
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import fail
from pcmrs.cli.tables import Terminal, print_table, styled
from pcmrs.cli.teleop import report_line
from pcmrs.doctor import Examination
from pcmrs.errors import PcmrsError
from pcmrs.fsm.finding import Finding
from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag, DeviceEvent, Reason, Snapshot, UnknownOutcome, Verdict
from pcmrs.replay import ReplayReport
from pcmrs.service.health.report import report
from tests.support.health_facts import WELL
from tests.support.hostile_text import FORGING, HOSTILE, check_no_effect, printed

TAG = BlueprintTag(id="ratms", version="1", hash="0")


def verdict(text: str) -> Verdict:
    reason = Reason(code=text, text=text)
    return Verdict(
        id=text, branch=text, operation=text, decision="rejected", state=text, sequence=1, reason=reason, allowed=[text]
    )


def state(text: str) -> None:
    unknown = UnknownOutcome(command=text, source=text, branch=text, operation=text, since=0.0)
    cell._print_snapshot(
        Snapshot(
            sequence=1,
            branches={text: text},
            flags={text: True},
            running=[],
            latched=True,
            blueprint=TAG,
            unknown=[unknown],
            release=[text],
        )
    )


def journal_row(text: str) -> None:
    row = JournalRow(
        kind="outcome",
        wall=0.0,
        monotonic=0.0,
        boot_id="",
        session_id="",
        blueprint=TAG,
        source=text,
        branch=text,
        operation=text,
        verdict=verdict(text),
    )
    say(journal._line(cast(Any, SimpleNamespace(sequence=1, row=row))))


def logged(text: str) -> None:
    root = logging.getLogger()
    handlers, root.handlers = root.handlers, []
    try:
        log_standard_library(sys.stderr, "%(levelname)s %(message)s")
        # A line break begins an indented line.
        logging.getLogger("pcmrs").warning("Ignored a message on %s", text.replace("\n", ""))
    finally:
        root.handlers = handlers


def ended(work: Callable[[], None]) -> None:
    with click.Context(click.Command("pcmrs"), info_name="pcmrs"), suppress(SystemExit):
        work()


def answer(text: str) -> None:
    archive._say_answer(pa.table({"name": [text]}).to_reader(), as_json=False)


def verified(text: str) -> ArchiveVerification:
    problem = SimpleNamespace(text=text)
    return cast(ArchiveVerification, SimpleNamespace(journals=(), problems=(problem,), unlisted=(text,)))


def differences(text: str) -> ReplayReport:
    each = SimpleNamespace(sequence=1, row=text, what=text, recorded=text, decided=text)
    facts = {"journal": text, "rows": 1, "runs": 1, "compared": 1, "answered": 0, "rows_per_second": 1.0}
    return cast(ReplayReport, SimpleNamespace(**facts, is_same=False, differences=[each]))


def examined(text: str) -> Examination:
    check = SimpleNamespace(check=text, verdict="bad", found=text, remedy=f"x{text}")
    return cast(Examination, SimpleNamespace(findings=[check]))


def progress(text: str) -> None:
    with progress_bar() as show:
        show(text, 1, 1)


def status(text: str) -> None:
    with Terminal(stderr=True).status(styled(text)):
        pass


PRINTED: dict[str, Callable[[str], None]] = {
    "archive ask": answer,
    "archive verify": lambda text: print_table(archive._verified(verified(text))),
    "bar": progress,
    "call": lambda text: say(cell.event_line(verdict(text))),
    "doctor": lambda text: print_table(doctor._table(examined(text))),
    "export-session": lambda text: say_lines(
        export_session._lines(
            cast(
                Any,
                SimpleNamespace(
                    session="1", folder="f", rows=1, recordings=(), calibrations=(), missing=(text,), problems=(text,)
                ),
            )
        )
    ),
    "fsm findings": lambda text: ended(
        lambda: files.fail_with_findings([Finding(code="x", text=text, commands=(text,))], readable=True)
    ),
    "fsm simulate": lambda text: simulate._show(
        cast(Any, SimpleNamespace(command=text, decision="rejected", by=text, at=0.0, lines=lambda: [text]))
    ),
    "health": lambda text: print_table(health_table(report(replace(WELL, metrics=f"x{text}")))),
    "journal": journal_row,
    "journal replay": lambda text: print_table(journal_replay._table(differences(text))),
    "json": say_json,
    "log": logged,
    "play": lambda text: say_lines(
        playback._lines(cast(Any, SimpleNamespace(messages=1, duration=1.0, prefix=text, lost_bytes=1, damage=[text])))
    ),
    "record": lambda text: say_lines(
        recording._summary(
            cast(Any, SimpleNamespace(messages=1, duration=1.0, dropped=0, removed=0, files=[text], error=text))
        )
    ),
    "register": lambda text: register._say({"name": text}, [text], as_json=False),
    "register --json": lambda text: register._say({"name": text}, [text], as_json=True),
    "state": state,
    "status": status,
    "teleop": lambda text: say(report_line(verdict(text))),
    "watch": lambda text: say(cell.event_line(DeviceEvent(device=text, code=text, text=text))),
}
"""What prints foreign text, by the command."""
TITLED = ("journal replay",)
"""Tables whose title wraps, so that their number of lines depends on their width."""


@pytest.fixture(scope="module", autouse=True)
def wide() -> Iterator[None]:
    """A terminal on which no line is wrapped, so that each line that begins is one that was printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "3000")
        yield


@pytest.mark.parametrize("command", PRINTED)
@given(text=HOSTILE)
@example(text="[/x]")
@example(text=FORGING)
def test_foreign_text_has_no_effect_on_a_terminal(command: str, text: str) -> None:
    check_no_effect(PRINTED[command], text, titled=command in TITLED)


def test_brackets_and_colons_are_shown_as_they_are() -> None:
    text = "[/x] [link=https://example.org]x[/link] :warning:"
    assert text in "\n".join(printed(PRINTED["state"], text))
    assert text in "\n".join(printed(lambda text: Terminal(force_terminal=True).print(text, highlight=False), text))


def failed(text: str) -> None:
    ended(lambda: fail(PcmrsError(text)))


def refused(text: str) -> None:
    ended(lambda: files.refuse(text))


@pytest.mark.parametrize("work", [failed, refused])
@given(text=HOSTILE)
def test_further_lines_of_an_error_are_indented(work: Callable[[str], None], text: str) -> None:
    first, *more, last = printed(work, text)
    assert first.startswith("pcmrs: ")
    assert last == ""
    assert all(not line or line.startswith("  ") for line in more)
    assert all(line.isprintable() for line in [first, *more])


class TerminalOutput(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("output", "shown"), [(TerminalOutput, "a\\u001b[2J\tb\n"), (io.StringIO, "a\x1b[2J\tb\n")])
def test_only_a_terminal_gets_a_document_escaped(output: type[io.StringIO], shown: str) -> None:
    with redirect_stdout(output()) as out:
        write_document("a\x1b[2J\tb\n")
    assert out.getvalue() == shown
