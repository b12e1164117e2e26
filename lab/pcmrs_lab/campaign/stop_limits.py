"""Limits of Stop while another process floods the cell, compared with the lateness of a bare timer in the same run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from pcmrs_lab.campaign.lateness import percentile

DURING_FLOODS: Final = {"p99": 0.050, "max": 0.100}
"""Limits from a press until Stop has begun, s: the machine itself may add the lateness of a bare timer."""
_SHARES: Final = {"p99": 0.99, "max": 1.0}


def exceeded(taken: Sequence[float], timer: Sequence[float]) -> Iterator[str]:
    """Yield a description of each limit that Stops have exceeded.

    Args:
        taken: Times of the Stops, s; a p99 of fewer than 100 is their maximum.
        timer: Lateness of a bare timer in the same run, s.
    """
    for name, limit in DURING_FLOODS.items():
        measured, late = (percentile(values, _SHARES[name]) for values in (taken, timer))
        if measured > limit + late:
            yield (
                f"{name} {1e3 * measured:.1f} ms, limit {1e3 * limit:g} ms and the bare timer's lateness of "
                f"{1e3 * late:.1f} ms."
            )
