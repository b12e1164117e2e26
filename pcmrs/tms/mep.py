"""The motor evoked potential in an epoch of the electromyogram, and whether it can be believed."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from pcmrs.tms.settings import MepSettings

LEAST_RATE_HZ = 1000.0
"""Surface electromyograms reach up to 500 Hz: Merletti, J. Electromyogr. Kinesiol. 9 (1999), standards of ISEK."""

LARGEST = 1.0
"""Offset of the electrodes and stimulus artefact included, V; more is in another unit."""

ONSET_SHARE = 0.1
ONSET_SIGMA = 3.0
"""A response begins where the signal leaves its baseline by a share of its amplitude, and by more than its noise."""

SATURATED_SHARE = 0.99
"""Of the full scale: noise and gain keep an amplifier at its rail just below it."""

HELD = 5
"""So many equal samples in a row at the greatest or least value are a rail, where the amplifier names none."""


class Mep(msgspec.Struct, frozen=True):
    """What one pulse evoked.

    Attributes:
        peak_to_peak: Within the window, V, without hum.
        latency: From the pulse until the response begins, s; None when there is none.
        peak: Time of the greatest value within the window since the pulse, s.
        trough: The same of the least.
        baseline_rms: Activity before the pulse, without offset and hum, V.
        preactivated: The muscle was not at rest.
        saturated: The amplifier was at its limit, before the pulse or within the window.
        artefact: The stimulus reaches into the window.
        present: There is a response, and it can be believed.
    """

    peak_to_peak: float
    latency: float | None
    peak: float
    trough: float
    baseline_rms: float
    preactivated: bool
    saturated: bool
    artefact: bool
    present: bool

    @property
    def valid(self) -> bool:
        """Whether the measurement can be believed; otherwise the pulse says nothing, not even that there is none."""
        return not (self.preactivated or self.saturated or self.artefact)


def judge_mep(epoch: Epoch, settings: MepSettings) -> Mep:
    """Looks for the response to a pulse.

    Raises:
        RefusalError: ``bad_epoch``: no samples, some that are not finite or not in V, or a rate that no electromyogram
            has; ``epoch_too_short``: baseline or window lie outside; ``emg_dead``: every sample is the same.
    """
    times, signal = waveform(epoch, settings)
    raw = np.asarray(epoch.samples)
    baseline = _part(times, settings.baseline_start, settings.baseline_end, "baseline")
    window = _part(times, settings.window_start, settings.window_end, "window")
    rms = float(np.sqrt(np.mean(signal[baseline] ** 2)))
    before = _part(times, settings.window_start - settings.artefact_time, settings.window_start, "window")
    preactivated = rms > settings.preactivation_uv * 1e-6
    saturated = any(_at_rail(raw[part], epoch.full_scale) for part in (baseline, window))
    artefact = bool(abs(signal[before].mean()) > settings.artefact_uv * 1e-6)
    peak_to_peak = float(np.ptp(signal[window]))
    present = peak_to_peak >= settings.threshold_uv * 1e-6 and not (preactivated or saturated or artefact)
    return Mep(
        peak_to_peak=peak_to_peak,
        latency=_onset(times[window], signal[window], rms) if present else None,
        peak=float(times[window][np.argmax(signal[window])]),
        trough=float(times[window][np.argmin(signal[window])]),
        baseline_rms=rms,
        preactivated=preactivated,
        saturated=saturated,
        artefact=artefact,
        present=present,
    )


def waveform(epoch: Epoch, settings: MepSettings) -> tuple[Floats, Floats]:
    """Times since the pulse, s, and the signal less the offset and the hum of its baseline, V, both (N,).

    Regression-subtraction: offset, sine and cosine are fitted to the baseline by least squares, and continued under the
    response (Mewett, Nazeran, Reynolds, Removing power line noise from recorded EMG, EMBC 2001). It leaves the shape of
    the response alone, which a notch filter does not.

    Raises:
        RefusalError: As `judge_mep`.
    """
    times, samples = _checked(epoch)
    baseline = _part(times, settings.baseline_start, settings.baseline_end, "baseline")
    phase = 2.0 * np.pi * settings.mains_hz * times
    columns = [np.ones_like(times)] + ([np.sin(phase), np.cos(phase)] if settings.mains_hz else [])
    design = np.stack(columns, axis=1)
    fit = np.linalg.lstsq(design[baseline], samples[baseline])[0]
    return times, samples - design @ fit


def _checked(epoch: Epoch) -> tuple[Floats, Floats]:
    """Times since the pulse, s, and samples, V, both (N,)."""
    samples = np.asarray(epoch.samples, dtype=float)
    if not LEAST_RATE_HZ <= epoch.rate_hz < math.inf or not math.isfinite(epoch.start):
        raise RefusalError(
            "bad_epoch",
            f"{epoch.rate_hz} samples per second from {epoch.start} s on are no electromyogram; it needs "
            f"{LEAST_RATE_HZ:g} at least.",
            rate_hz=epoch.rate_hz,
        )
    wrong = int(np.sum(~np.isfinite(samples)))
    if wrong or not len(samples):
        raise RefusalError(
            "bad_epoch", f"{wrong} of {len(samples)} samples are no numbers. Check the amplifier.", wrong=wrong
        )
    if np.ptp(samples) == 0.0:
        raise RefusalError(
            "emg_dead", f"The signal of {epoch.muscle} does not change at all. Check electrodes and amplifier."
        )
    if np.abs(samples).max() > LARGEST:
        raise RefusalError(
            "bad_epoch",
            f"The largest sample is {np.abs(samples).max():g} V; none is larger than {LARGEST:g} V. Check its unit.",
            largest=float(np.abs(samples).max()),
        )
    return epoch.start + np.arange(len(samples)) / epoch.rate_hz, samples


def _part(times: Floats, start: float, end: float, name: str) -> slice:
    """The samples from `start` to `end`, s since the pulse."""
    half = 0.5 * (times[1] - times[0]) if len(times) > 1 else 0.0
    first, last = (int(index) for index in np.searchsorted(times, (start - half, end + half)))
    if times[0] > start + half or times[-1] < end - half or last - first < 3:
        raise RefusalError(
            "epoch_too_short",
            f"The {name} goes from {start:g} s to {end:g} s since the pulse, but the epoch from {times[0]:g} s to "
            f"{times[-1]:g} s. Record a longer one.",
            start=float(times[0]),
            end=float(times[-1]),
        )
    return slice(first, last)


def _at_rail(raw: Floats, full_scale: float | None) -> bool:
    """Whether the amplifier was at its limit; where it names none, whether the signal stays at its extremes."""
    if full_scale is not None:
        return bool(np.abs(raw).max() >= SATURATED_SHARE * full_scale)
    return any(_longest_run(raw == extreme) >= HELD for extreme in (raw.max(), raw.min()))


def _longest_run(flags: np.typing.NDArray[np.bool_]) -> int:
    """Of True."""
    changes = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return int(np.diff(changes)[::2].max(initial=0))


def _onset(times: Floats, signal: Floats, rms: float) -> float:
    """When the response begins; the signal is large within the window, so there is such a time."""
    limit = max(ONSET_SHARE * float(np.ptp(signal)), min(ONSET_SIGMA * rms, 0.5 * float(np.ptp(signal))))
    return float(times[np.argmax(np.abs(signal) >= limit)])
