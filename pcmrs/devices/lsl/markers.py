"""Markers as texts on a stream of irregular rate; those of pulses are JSON."""

from __future__ import annotations

import msgspec

from pcmrs.devices.lsl.library import load_lsl

PULSES = "pcmrs_pulses"
"""Name of the stream on which the stimulator's pulses are marked, unless configured otherwise."""


class PulseMarker(msgspec.Struct, frozen=True):
    """A pulse, marked at the moment at which it was given.

    Attributes:
        pulse: Its number.
        intensity: Percent of the maximum stimulator output; None where only the operator knows.
    """

    pulse: int
    intensity: float | None = None

    @property
    def text(self) -> str:
        """What is sent, such as ``{"pulse":3,"intensity":55.0}``."""
        return msgspec.json.encode(self).decode()


def read_pulse(text: str | bytes) -> PulseMarker | None:
    """The pulse that a marker means; None for any other marker."""
    try:
        return msgspec.json.decode(text, type=PulseMarker)
    except (msgspec.DecodeError, UnicodeError):
        return None


class MarkerOutlet:
    """A stream of markers; pushing never waits, whoever listens or not.

    Args:
        name: Of the stream.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, name: str) -> None:
        lsl = load_lsl()
        # A recorder goes on with the stream of the same source after a restart.
        info = lsl.StreamInfo(name, "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_string, f"pcmrs:{name}")
        self._outlet = lsl.StreamOutlet(info)

    def push(self, text: str, time: float = 0.0) -> None:
        """Marks `time`, s of the library's clock; 0 is now."""
        self._outlet.push_sample([text], time)
