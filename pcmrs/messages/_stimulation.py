"""Pulses of a magnetic stimulator, and the responses of a muscle."""

from __future__ import annotations

from pcmrs.messages._base import Message


class StimulatorState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """State of a magnetic stimulator.

    Attributes:
        armed: True if it can fire.
        ready: True if it is charged, and cool enough to fire.
        intensity: Intensity, percent of the maximum stimulator output; None if only the operator at its dial knows it.
        coil_temperature: Temperature of the coil, degrees Celsius; None if it has no sensor.
        pulse: Number of the last pulse; 0 before the first.
    """

    armed: bool
    ready: bool
    intensity: float | None
    coil_temperature: float | None
    pulse: int


class FiredPulse(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A pulse that was given.

    Attributes:
        number: Number of the pulse in its request.
        intensity: Intensity, percent of the maximum stimulator output; None if only the operator knows it.
        fired: Time of the pulse, s of the node's clock.
    """

    number: int
    intensity: float | None
    fired: float


class Epoch(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A stretch of one muscle's electromyogram around a pulse, as it was measured.

    Attributes:
        pulse: Number of the pulse.
        muscle: Name of the channel.
        rate_hz: Samples per second.
        start: Time of the first sample relative to the pulse, s; negative before it.
        samples: Signal, evenly spaced, V.
        full_scale: Magnitude at which the amplifier saturates, V; None if it is unknown.
    """

    pulse: int
    muscle: str
    rate_hz: float
    start: float
    samples: list[float]
    full_scale: float | None = None
