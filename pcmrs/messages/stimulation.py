"""Pulses of a magnetic stimulator, and what a muscle answers."""

from __future__ import annotations

from pcmrs.messages.base import Message


class StimulatorState(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What a magnetic stimulator says of itself.

    Attributes:
        ready: Charged, and cool enough to fire.
        intensity: Percent of the maximum stimulator output; None where only the operator at its dial knows.
        coil_temperature: Degrees Celsius; None where it has no sensor.
        pulse: Number of the last pulse it fired; 0 before the first.
    """

    armed: bool
    ready: bool
    intensity: float | None
    coil_temperature: float | None
    pulse: int


class FiredPulse(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A pulse that was given.

    Attributes:
        number: Of the pulse, as it was asked for.
        intensity: Percent of the maximum stimulator output; None where only the operator knows.
        fired: Of the node's clock, s.
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
        start: Time of the first sample since the pulse, s: negative before it.
        samples: V, evenly spaced.
        full_scale: Magnitude at which the amplifier saturates, V; None where it does not say.
    """

    pulse: int
    muscle: str
    rate_hz: float
    start: float
    samples: list[float]
    full_scale: float | None = None
