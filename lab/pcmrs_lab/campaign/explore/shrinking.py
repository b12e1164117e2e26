"""Makes a failing script short: delta debugging over its acts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from pcmrs_lab.campaign.explore.script import Act, Script

MOST_RUNS = 200
"""Nobody waits for a shorter script than this many runs find."""


def shrink(script: Script, fails: Callable[[Script], bool], most: int = MOST_RUNS) -> Script:
    """The shortest script found that still fails: no act of it can be left out alone, unless `most` was too few.

    Zeller, Hildebrandt, Simplifying and Isolating Failure-Inducing Input, IEEE TSE 2002, without the tests of single
    parts, which hardly ever fail by themselves here.

    Args:
        script: That fails.
        fails: Whether a script fails in the same way.
        most: Runs.
    """
    acts, parts, runs = list(script.acts), 2, 0
    while len(acts) >= 2 and runs < most:
        for start, end in _parts(len(acts), parts):
            runs += 1
            fewer = acts[:start] + acts[end:]
            if fails(_with(script, fewer)):
                acts, parts = fewer, max(2, parts - 1)
                break
            if runs >= most:
                break
        else:
            if parts >= len(acts):
                break
            parts = min(len(acts), 2 * parts)
    return _with(script, acts)


def _parts(length: int, parts: int) -> list[tuple[int, int]]:
    size = -(-length // parts)
    return [(start, min(length, start + size)) for start in range(0, length, size)]


def _with(script: Script, acts: Sequence[Act]) -> Script:
    return msgspec.structs.replace(script, acts=list(acts))
