"""Limits of the interval between single pulses, and of their number."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.errors import RefusalError

__all__ = ["IntervalSettings", "check_count", "check_interval"]


class IntervalSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of single pulses.

    Pulses at 1 Hz or faster are repetitive stimulation, which has its own limits and is not supported here (Rossi et
    al., Clin. Neurophysiol. 120 (2009) 2008 and 132 (2021) 269). At 0.9 Hz for a quarter of an hour motor evoked
    potentials become smaller, at 0.1 Hz they do not (Chen et al., Neurology 48 (1997) 1398). At intervals of 5 s they
    are smaller and vary more than at 10 s (Hassanzahraee et al., Brain Connect. 9 (2019)).

    Attributes:
        least: Least interval between two pulses, s.
        most_pulses: Greatest number of pulses in one session. The longest trains at 1 Hz that were found safe up to
            110 % of the threshold had 1,800 pulses (Rossi et al. 2009).
    """

    least: Annotated[float, msgspec.Meta(gt=1.0, le=60.0)] = 5.0
    most_pulses: Annotated[int, msgspec.Meta(ge=1, le=1800)] = 500


def check_interval(now: float, last: float | None, given: int, settings: IntervalSettings) -> None:
    """Refuse a pulse that would come too soon.

    Args:
        now: Present time, s, on the clock of `last`.
        last: Time from which the interval counts, s: the last pulse, or arming before the first pulse and after one
            whose outcome was unknown. None before arming.
        given: Number of pulses given in this session.
        settings: Limits of single pulses.

    Raises:
        RefusalError: ``pulse_too_soon``. Its field ``wait`` is the remaining time, s.
    """
    if last is None or now - last >= settings.least:  # nan counts as too soon
        return
    wait = settings.least - (now - last)
    since = f"{now - last:.2f} s ago"
    if given == 0:
        text = f"No pulse was given yet, so the interval counts from arming, {since};"
    else:
        text = f"The last pulse, or arming after one with an unknown outcome, was {since};"
    raise RefusalError(
        "pulse_too_soon",
        f"{text} at least {settings.least:g} s must pass. Wait {wait:.2f} s.",
        since=now - last,
        least=settings.least,
        wait=wait,
    )


def check_count(given: int, settings: IntervalSettings) -> None:
    """Refuse a pulse after too many.

    Args:
        given: Number of pulses given in this session.
        settings: Limits of single pulses.

    Raises:
        RefusalError: ``too_many_pulses``.
    """
    if given >= settings.most_pulses:
        raise RefusalError(
            "too_many_pulses",
            f"{given} pulses were given in this session; the limit is {settings.most_pulses}. End the session.",
            given=given,
            most_pulses=settings.most_pulses,
        )
