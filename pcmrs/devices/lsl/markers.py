"""Markers: texts on a stream of irregular rate; those of pulses are JSON."""

from __future__ import annotations

import msgspec

from pcmrs.devices.lsl.library import load_lsl

PULSES = "pcmrs_pulses"
"""Default name of the stream with the markers of the stimulator's pulses."""


class PulseMarker(msgspec.Struct, frozen=True):
    """Marker of a pulse, sent when the pulse is given.

    Attributes:
        pulse: Number of the pulse.
        intensity: Intensity, percent of the maximum stimulator output; None if only the operator knows it.
    """

    pulse: int
    intensity: float | None = None

    @property
    def text(self) -> str:
        """Text of the marker, such as ``{"pulse":3,"intensity":55.0}``."""
        return msgspec.json.encode(self).decode()


def read_pulse(text: str | bytes) -> PulseMarker | None:
    """Return the pulse of a marker; None for any other marker."""
    try:
        return msgspec.json.decode(text, type=PulseMarker)
    except (msgspec.DecodeError, UnicodeError):
        return None


class MarkerOutlet:
    """A stream of markers; pushing never waits, with or without readers.

    Args:
        name: Name of the stream.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, name: str) -> None:
        lsl = load_lsl()
        # The same source id after a restart lets recorders continue with this stream.
        info = lsl.StreamInfo(name, "Markers", 1, lsl.IRREGULAR_RATE, lsl.cf_string, f"pcmrs:{name}")
        self._outlet = lsl.StreamOutlet(info)

    def push(self, text: str, time: float = 0.0) -> None:
        """Send a marker.

        Args:
            text: Text of the marker.
            time: Time that is marked, s of the library's clock; 0 for now.
        """
        self._outlet.push_sample([text], time)
