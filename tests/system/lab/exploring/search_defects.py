"""Puts defects back, one at a time, and explores until each is found and shrunk; see docs/explore.md.

.venv/bin/python -m tests.system.lab.exploring.search_defects [NAME ...] [--minutes 10] [--jobs 2] [--seed 1] [--write]
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from collections.abc import Iterator
from itertools import count
from resource import RUSAGE_CHILDREN, getrusage
from time import monotonic

import pytest

from pcmrs_lab.campaign.explore.exploring import as_lines
from pcmrs_lab.campaign.explore.generate import draw_script
from pcmrs_lab.campaign.explore.script import SessionScript, shrink, write_script
from pcmrs_lab.campaign.explore.session import run_session
from pcmrs_lab.campaign.explore.settings import workflow_of
from tests.system.lab.exploring.defects import DEFECTS, Defect

MOST_ACTS = 12
"""A script that is longer than this explains nothing."""


def search(name: str, seed: int, step: int, minutes: float) -> SessionScript | None:
    """Explores every `step`-th seed from `seed` on.

    Args:
        name: Of the defect.
        seed: Of the first session.
        step: From one seed to the next.
        minutes: Of the machine, with shrinking.

    Returns:
        A script of at most `MOST_ACTS` acts that shows the defect and holds on the product; None when the time is up.
    """
    defect, end = DEFECTS[name], monotonic() + 60.0 * minutes
    blueprint = workflow_of(defect.workflow).blueprint
    for each in count(seed, step):
        if monotonic() > end:
            return None
        script = draw_script(blueprint, defect.workflow, each)
        if not _shows(defect, script):
            continue
        shorter = shrink(script, lambda given: monotonic() < end and _shows(defect, given))
        if len(shorter.acts) <= MOST_ACTS and not run_session(shorter).invariant:
            return shorter
    return None


def _shows(defect: Defect, script: SessionScript) -> bool:
    with pytest.MonkeyPatch.context() as patch:
        defect.apply(patch)
        return run_session(script).invariant in defect.found_by


def _by_all(defect: Defect, seed: int, jobs: int, minutes: float) -> Iterator[SessionScript | None]:
    """What the processes found, the first one first."""
    given = [(defect.name, seed + job, jobs, minutes) for job in range(jobs)]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap_unordered(_search_with, given)


def _search_with(given: tuple[str, int, int, float]) -> SessionScript | None:
    return search(*given)


def _cost() -> float:
    """Of the processor, by all processes that have ended, s."""
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> int:
    """Prints what was found; 0 when all were, within `MOST_ACTS` acts each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="defects to look for; all when none is given")
    parser.add_argument("--minutes", type=float, default=10.0, help="of the machine, for each defect")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--seed", type=int, default=1, help="of the first session")
    parser.add_argument("--write", action="store_true", help="keep the scripts beside the tests")
    options = parser.parse_args()
    missed = 0
    for name in options.names or DEFECTS:
        defect, before, started = DEFECTS[name], _cost(), monotonic()
        found = next((each for each in _by_all(defect, options.seed, options.jobs, options.minutes) if each), None)
        missed += found is None
        times = f"{monotonic() - started:.0f} s, {_cost() - before:.0f} s of the processor"
        sys.stdout.write(f"{name}: {'found' if found else 'NOT FOUND'} after {times}\n")
        if found is not None:
            sys.stdout.write(f"seed {found.seed}, {len(found.acts)} acts\n" + "\n".join(as_lines(found)) + "\n")
        if found is not None and options.write:
            defect.script.parent.mkdir(exist_ok=True)
            write_script(found, defect.script)
        sys.stdout.flush()
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
