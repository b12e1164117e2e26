"""Takes guards out of the product, one at a time, and counts how many of them the tests miss.

    python -m tests.mutants.run_mutants map [TESTS ...] [--workers 3]
    python -m tests.mutants.run_mutants uncovered
    python -m tests.mutants.run_mutants listed [NAME ...] [--part 1/4] [--jobs 2]
    python -m tests.mutants.run_mutants generated [--sample 200] [--seed 0] [--part 1/4] [--jobs 2]

`map` runs the suite once under coverage and writes down which test runs which line; the others choose their tests by
it. With TESTS it measures only these, and keeps what it knows of the others. It ends with 1 if a test failed or the
data of a process were lost: such a test is not chosen, so fewer mutants would be caught. `uncovered` lists the guards
with a side that no test runs. `listed` tries the mutants that are written down in tests/mutants/listed, each with the
harm that it could do; all of them must be caught, except those in allowed.toml. `generated` tries a sample of the
mutants that are made by rule; 95 % must be caught. Each command prints a table, or JSON with --json, and ends with 0 if
there is no finding.
"""

from __future__ import annotations

import argparse
import os
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from pcmrs.cli.progress import progress_bar
from tests import ROOT
from tests.mutants.coverage_map import MapError, read_map, write_map
from tests.mutants.generated_mutants import generated, guards, sample
from tests.mutants.listed_guards import listed
from tests.mutants.selecting_tests import Limits
from tests.mutants.trying import Allowed, Candidate, Found, Report, try_mutants
from tests.mutants.uncovered_guards import excuses, uncovered

LISTED = Limits(tests=1000, seconds=300.0)
GENERATED = Limits(tests=25, seconds=90.0)
GENERATED_WANTED = 0.95
"""Share of the generated mutants that must be caught: some of them change nothing that could be noticed."""

_ALLOWED = Path(__file__).with_name("allowed.toml")


def allowed() -> dict[str, Allowed]:
    """Read the listed mutants that need not be caught, by name."""
    entries = msgspec.convert(tomllib.loads(_ALLOWED.read_text())["allowed"], list[Allowed])
    return {entry.name: entry for entry in entries}


def candidates(names: Sequence[str]) -> list[Candidate]:
    """Return the listed mutants with these names, or all when there are none."""
    known = {mutant.name: mutant for mutant in listed()}
    unknown = sorted(set(names) - known.keys())
    if unknown:
        sys.exit(f"There is no mutant {', '.join(unknown)}.")
    return [
        Candidate(
            name=mutant.name,
            where=f"{mutant.module}:{mutant.function}",
            place=mutant.place(ROOT),
            without=mutant.without,
            harm=mutant.harm,
        )
        for mutant in (known[name] for name in names or known)
    ]


def _map(options: argparse.Namespace) -> int:
    before = read_map() if options.tests else None
    coverage = write_map(options.tests or ["tests"], options.workers, before=before)
    lines = sum(len(file.lines) for file in coverage.files.values())
    if options.json:
        summary = {"tests": len(coverage.tests), "failed": coverage.failed, "lines": lines, "lost": coverage.lost}
        sys.stdout.write(msgspec.json.encode(summary).decode() + "\n")
    else:
        table = Table(title="Which test runs which line")
        for name in ("tests that passed", "failed", "lines run", "processes without data"):
            table.add_column(name)
        table.add_row(*(str(each) for each in (len(coverage.tests), len(coverage.failed), lines, coverage.lost)))
        Console().print(table, *coverage.failed, sep="\n")
    return 1 if coverage.failed or coverage.lost else 0


def _listed(options: argparse.Namespace) -> int:
    return _print_report(options, _part(options.part, candidates(options.names)), LISTED, 1.0, allowed())


def _generated(options: argparse.Namespace) -> int:
    mutants = sample(generated(), options.sample, options.seed)
    return _print_report(options, _part(options.part, mutants), GENERATED, GENERATED_WANTED, {})


def _uncovered(options: argparse.Namespace) -> int:
    known = guards()
    found = uncovered(known, read_map(), excuses())
    if options.json:
        sys.stdout.write(msgspec.json.encode({"guards": len(known), "uncovered": found}).decode() + "\n")
    else:
        left = [each for each in found if not each.reason]
        table = Table(title=f"{len(found)} guards of which one side was never run, {len(left)} without a reason")
        for name in ("function", "guard", "side", "reason"):
            table.add_column(name, overflow="fold")
        for each in found:
            table.add_row(f"{each.module}:{each.function}", each.guard, each.side, each.reason)
        Console().print(table)
    return 0 if all(each.reason for each in found) else 1


def _print_report(
    options: argparse.Namespace,
    mutants: Sequence[Candidate],
    limits: Limits,
    wanted: float,
    excused: dict[str, Allowed],
) -> int:
    coverage, done = read_map(), 0
    with progress_bar() as bar:

        def show(found: Found) -> None:
            nonlocal done
            done += 1
            bar(f"{found.outcome} {found.name}", done, len(mutants))
            if not sys.stderr.isatty():
                sys.stderr.write(f"{done}/{len(mutants)} {found.outcome} {found.name} {found.by}\n")

        report = try_mutants(mutants, coverage, limits, wanted, allowed=excused, jobs=options.jobs, show=show)
    if options.json:
        sys.stdout.write(msgspec.json.encode(report).decode() + "\n")
    else:
        Console().print(_table(report), *(f"fails as it is: {test}" for test in report.unfit), sep="\n")
    return 0 if report.good else 1


def _table(report: Report) -> Table:
    required = len(report.mutants) - report.allowed
    title = f"{report.caught} of {required} mutants are caught: {report.share:.1%}; {report.allowed} need not be"
    table = Table(title=title)
    for name in ("mutant", "function", "outcome", "by, or what could go wrong"):
        table.add_column(name, overflow="fold")
    for each in sorted(report.mutants, key=lambda found: found.outcome):
        shown = {"caught": each.by, "broken": each.by}.get(each.outcome, each.allowed or each.harm or _difference(each))
        table.add_row(each.name, each.where, each.outcome, shown)
    return table


def _difference(found: Found) -> str:
    return f"- {found.guard}\n+ {found.without}"


def _part(part: str, mutants: Sequence[Candidate]) -> Sequence[Candidate]:
    """Return part k of n: every n-th mutant, so that each part has some of every package."""
    number, _, count = part.partition("/")
    return mutants[int(number) - 1 :: int(count)]


def main() -> int:
    """Run a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    mapping = commands.add_parser("map", help="run the suite under coverage")
    mapping.add_argument("tests", nargs="*", metavar="TESTS", help="files or folders; all tests when none is given")
    mapping.add_argument("--workers", type=int, default=3 * (os.cpu_count() or 1) // 2, help="so many processes")
    mapping.set_defaults(run=_map)
    trying_listed = commands.add_parser("listed", help="try the listed mutants")
    trying_listed.add_argument("names", nargs="*", metavar="NAME", help="mutants to try; all when none is given")
    trying_listed.set_defaults(run=_listed)
    trying_generated = commands.add_parser("generated", help="try mutants that are made by rule")
    trying_generated.add_argument("--sample", type=int, default=200, help="so many of them")
    trying_generated.add_argument("--seed", type=int, default=0, help="which ones")
    trying_generated.set_defaults(run=_generated)
    reading = commands.add_parser("uncovered", help="list the guards of which no test runs both sides")
    reading.set_defaults(run=_uncovered)
    for each in (trying_listed, trying_generated):
        each.add_argument("--part", default="1/1", metavar="K/N", help="only part K of N")
        each.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="so many at a time")
    for each in (mapping, reading, trying_listed, trying_generated):
        each.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    try:
        return int(options.run(options))
    except MapError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    sys.exit(main())
