"""The interface to the journal: rows on their way to the disk, and clipped arguments."""

from __future__ import annotations

from pcmrs.dispatcher.recorder import CLIPPED, LONGEST, clipped


def test_short_arguments_are_kept_and_of_long_ones_the_hash() -> None:
    short, long = {"text": "x"}, {"text": "x" * LONGEST}
    assert clipped(short) == short
    kept = clipped(long)
    assert set(kept) == {CLIPPED}
    assert kept[CLIPPED]["bytes"] > LONGEST
    assert clipped({"text": "x" * (LONGEST - 1) + "y"})[CLIPPED]["sha256"] != kept[CLIPPED]["sha256"]
    assert clipped(kept) == kept
