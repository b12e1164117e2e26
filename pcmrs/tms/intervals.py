"""How soon after another, and how often, single pulses may be given."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.errors import RefusalError


class IntervalSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of single pulses.

    Pulses that follow each other at 1 Hz or faster are repetitive stimulation, which has limits of its own and is not
    given here (Rossi et al., Clin. Neurophysiol. 120 (2009) 2008 and 132 (2021) 269). At 0.9 Hz for a quarter of an
    hour motor evoked potentials become smaller, at 0.1 Hz not (Chen et al., Neurology 48 (1997) 1398); at intervals of
    5 s they are smaller and vary more than at 10 s (Hassanzahraee et al., Brain Connect. 9 (2019)).

    Attributes:
        least: From one pulse to the next, s.
        most_pulses: In one session. The longest trains at 1 Hz that were found safe up to 110 % of the threshold had
            1,800 (Rossi et al. 2009).
    """

    least: Annotated[float, msgspec.Meta(gt=1.0, le=60.0)] = 5.0
    most_pulses: Annotated[int, msgspec.Meta(ge=1, le=1800)] = 500


def check_interval(now: float, last: float | None, settings: IntervalSettings) -> None:
    """Refuses a pulse that would come too soon.

    Args:
        now: Of the clock that also said when `last` was, s.
        last: When the last pulse was given; None before the first.
        settings: The limits.

    Raises:
        RefusalError: ``pulse_too_soon``; the field ``wait`` says how long to wait, s.
    """
    if last is None or now - last >= settings.least:  # a nan passes for too soon
        return
    wait = settings.least - (now - last)
    raise RefusalError(
        "pulse_too_soon",
        f"The last pulse was {now - last:.2f} s ago; at least {settings.least:g} s must pass. Wait {wait:.2f} s.",
        since=now - last,
        least=settings.least,
        wait=wait,
    )


def check_count(given: int, settings: IntervalSettings) -> None:
    """Refuses a pulse after too many.

    Args:
        given: Pulses in this session.
        settings: The limits.

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
