"""Makes docs/evidence.md: what each promise of the documents is proved by, and how the last nightly run of that ended.

make evidence
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import takewhile

from pcmrs_lab.campaign.catalogue import catalogue
from tests.nightly.in_a_row import kept
from tests.nightly.nightly_parts import Part, chosen, holders, parts
from tests.nightly.nightly_results import Result, published
from tests.support.documents import DOCS, SOURCES, Cited, Promise, Source, promises

PAGE = DOCS / "evidence.md"
WANTED_IN_A_ROW = 20
HEAD = """\
# Evidence

You find here by what each requirement and promise of the documents is proved, and how that ended when it was last run.
The page is made by `make evidence` and never edited; `make test` fails when it is not up to date. All is simulated.

The promises are those of [safety.md](safety.md), [semantics.md](semantics.md), [supervision.md](supervision.md) and
[threat-model.md](threat-model.md). What they name is below `tests/`, in the catalogue of faults (`pcmrs faults list`),
among the invariants of the explorer ([explore.md](explore.md)) and the mutants of `tests/mutants`.

`make test` runs all tests without the marker `nightly` or `browser`; CI runs those of the browser, too. `make nightly`
runs the rest in parts: `make nightly PART=faults` runs some. Parts that have a green result for the present code are
left out. `make nightly OPTIONS=--publish` gathers the results for this page, which says of each part on which commit it
was run.
"""


def page() -> str:
    """The whole page."""
    known = {result.part: result for result in published()}
    sections = [HEAD, _last(known), _in_a_row()]
    for source in SOURCES:
        sections.append(_section(source, known))
    return "\n".join(sections)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _last(known: dict[str, Result]) -> str:
    head = ("part", "result", "commit", "begun, UTC", "passed", "failed", "skipped", "min", "machine")
    machines = sorted({_machine(result) for result in known.values()})
    rows = [_line(part, known.get(part.name), machines) for part in parts()]
    total = sum(result.seconds for result in known.values()) / 60
    lines = [f"{len(known)} of {len(rows)} parts were run, in {total:.0f} min.\n", _table(head, rows)]
    if machines:
        lines.append("".join(f"- Machine {number}: {each}\n" for number, each in enumerate(machines, start=1)))
    told = [f"- {name}: {each}\n" for name, result in known.items() for each in _exceptions(result)]
    if told:
        lines.append("What failed or was skipped:\n\n" + "".join(told))
    text = "\n".join(lines)
    return f"## Last nightly runs\n\n{text}"


def _line(part: Part, result: Result | None, machines: list[str]) -> list[str]:
    if result is None:
        return [f"`{part.name}`", "not run", *[""] * 5, f"expected: {part.minutes:g}", ""]
    machine = str(machines.index(_machine(result)) + 1)
    return [f"`{part.name}`", _state(result), *_seen(result), machine]


def _seen(result: Result) -> list[str]:
    """Cells of a table: commit, begin, how many passed, failed and were skipped, and minutes."""
    return [
        result.commit[:7] + result.commit[40:],
        result.begun[:16].replace("T", " "),
        *map(str, (result.passed, result.failed, sum(result.skipped.values()))),
        f"{result.seconds / 60:.1f}",
    ]


def _machine(result: Result) -> str:
    machine = result.machine
    return f"{machine.cores} cores, {machine.processor}, Python {machine.python}, Linux {machine.kernel}"


def _exceptions(result: Result) -> Iterator[str]:
    yield from (f"failed: `{each}`" for each in result.failures)
    yield from (f"skipped {often}: {reason}" for reason, often in result.skipped.items())


def _in_a_row() -> str:
    runs = kept()
    head = ("run", "commit", "begun, UTC", "passed", "failed", "skipped", "min", "exit code", "computing beside it")
    rows = [
        [str(number), *_seen(run.result), str(run.result.exit_code), str(run.beside)]
        for number, run in enumerate(runs, start=1)
    ]
    green = list(takewhile(lambda run: run.result.green, reversed(runs)))
    said = (
        f"The last {len(green)} of {len(runs)} recorded runs were green, {sum(run.beside > 0 for run in green)} of "
        f"them with computing processes beside them; {WANTED_IN_A_ROW} are wanted.\n"
    )
    return "## Runs of make test in a row\n\n" + said + ("\n" + _table(head, rows) if rows else "")


def _section(source: Source, known: dict[str, Result]) -> str:
    found = promises(source)
    head = ["", "promise", "tests", "faults", *(("watched by", "breaks without") if source.proved else ()), "nightly"]
    rows = [
        [
            each.id,
            each.text,
            "<br>".join(map(_test, each.tests)),
            ", ".join(each.rows),
            *((each.watched, each.without) if source.proved else ()),
            _nightly(each, known),
        ]
        for each in found
    ]
    return f"## {source.heading}\n\nFrom [{source.page}]({source.page}).\n\n{_table(head, rows)}"


def _test(each: Cited) -> str:
    return f"`{each.file}::{each.test}`" + (f" ({each.only})" if each.only else "")


def parts_of(promise: Promise) -> list[str]:
    """Names of the parts that run what proves a promise beyond `make test`."""
    wanted = [name for each in promise.tests if each.only for name in holders(each.file)]
    for row in promise.rows:
        wanted += [
            f"faults-{catalogue()[row].fault_class}",
            f"faults-{row.lower()}",
        ]  # a row with more seeds has one more part
    if promise.rows:
        wanted += [part.name for part in chosen("sham")]
    if "`" in promise.watched:
        wanted += [part.name for part in chosen("explore")]
    if "`" in promise.without:
        wanted += [part.name for part in chosen("mutants-listed")]
    return [part.name for part in parts() if part.name in wanted]


def _nightly(promise: Promise, known: dict[str, Result]) -> str:
    """States of these parts: each state once, with those that are in it."""
    by_state: dict[str, list[str]] = {}
    for name in parts_of(promise):
        result = known.get(name)
        by_state.setdefault("not run" if result is None else _state(result), []).append(name)
    return "<br>".join(f"{state}: {', '.join(names)}" for state, names in by_state.items())


def _state(result: Result) -> str:
    return "green" if result.green else "**red**"


if __name__ == "__main__":
    PAGE.write_text(page())
