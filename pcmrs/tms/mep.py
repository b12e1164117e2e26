"""Motor evoked potential (MEP) in an epoch of the electromyogram, and the validity of its measurement."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from pcmrs.tms.settings import MepSettings

__all__ = ["Mep", "judge_mep", "waveform"]

MIN_RATE_HZ = 1000.0
"""Least sampling rate. Surface electromyograms contain frequencies up to 500 Hz (Merletti, J. Electromyogr. Kinesiol. 9
(1999), standards of ISEK)."""

MAX_VOLTAGE = 1.0
"""Largest plausible sample, including the offset of the electrodes and the stimulus artefact, V. A larger one is in
another unit."""

ONSET_SHARE = 0.1
"""Share of the peak-to-peak amplitude by which the signal leaves its baseline when a response begins."""

ONSET_SIGMA = 3.0
"""Multiple of the baseline's noise by which the signal leaves its baseline when a response begins."""

SATURATED_SHARE = 0.99
"""Share of the full scale from which on the amplifier is saturated. Noise and gain keep its rail just below the full
scale."""

RAIL_SAMPLES = 5
"""Number of equal successive samples at the greatest or least value that show saturation if the amplifier reports no
full scale."""


class Mep(msgspec.Struct, frozen=True):
    """Motor evoked potential of one pulse.

    Attributes:
        peak_to_peak: Peak-to-peak amplitude within the window, without hum, V.
        latency: Time from the pulse to the onset of the response, s; None without a response.
        peak: Time of the greatest value within the window since the pulse, s.
        trough: Time of the least value within the window since the pulse, s.
        baseline_rms: Root mean square activity before the pulse, without offset and hum, V.
        preactivated: True if the muscle was not at rest.
        saturated: True if the amplifier was saturated before the pulse or within the window.
        artefact: True if the stimulus artefact reaches into the window.
        present: True if there is a response in a valid measurement.
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
        """True if the measurement is valid; otherwise it shows neither a response nor its absence."""
        return not (self.preactivated or self.saturated or self.artefact)


def judge_mep(epoch: Epoch, settings: MepSettings) -> Mep:
    """Return the response to a pulse.

    Args:
        epoch: Electromyogram around the pulse.
        settings: Window, baseline and limits.

    Raises:
        RefusalError: ``bad_epoch``: there are no samples, some are not finite or not in V, or the sampling rate is not
            plausible; ``epoch_too_short``: baseline or window lie outside; ``emg_dead``: every sample is the same.
    """
    times, signal = waveform(epoch, settings)
    # Saturation is visible in the raw samples only, because the removal of the hum bends a rail.
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
    """Return times since the pulse, s, and the signal without offset and hum, V, both (N,).

    Regression-subtraction: offset, sine and cosine are fitted to the baseline by least squares, and continued under the
    response (Mewett, Nazeran, Reynolds, Removing power line noise from recorded EMG, EMBC 2001). Unlike a notch filter,
    it leaves the shape of the response unchanged.

    Args:
        epoch: Electromyogram around the pulse.
        settings: Baseline and frequency of the mains.

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
    """Return times since the pulse, s, and samples, V, both (N,). Raises `RefusalError` as `judge_mep`."""
    samples = np.asarray(epoch.samples, dtype=float)
    if not MIN_RATE_HZ <= epoch.rate_hz < math.inf or not math.isfinite(epoch.start):
        raise RefusalError(
            "bad_epoch",
            f"{epoch.rate_hz} samples per second from {epoch.start} s on are not an electromyogram; it needs at least "
            f"{MIN_RATE_HZ:g} samples per second.",
            rate_hz=epoch.rate_hz,
        )
    wrong = int(np.sum(~np.isfinite(samples)))
    if wrong or not len(samples):
        raise RefusalError(
            "bad_epoch", f"{wrong} of {len(samples)} samples are not numbers. Check the amplifier.", wrong=wrong
        )
    if np.ptp(samples) == 0.0:
        raise RefusalError(
            "emg_dead", f"The signal of {epoch.muscle} does not change at all. Check electrodes and amplifier."
        )
    if np.abs(samples).max() > MAX_VOLTAGE:
        raise RefusalError(
            "bad_epoch",
            f"The largest sample is {np.abs(samples).max():g} V, the limit is {MAX_VOLTAGE:g} V. Check its unit.",
            largest=float(np.abs(samples).max()),
        )
    return epoch.start + np.arange(len(samples)) / epoch.rate_hz, samples


def _part(times: Floats, start: float, end: float, name: str) -> slice:
    """Return the slice of samples from `start` to `end`, s since the pulse. Raises `RefusalError`."""
    # Half a period of tolerance, so that rounding of the times does not exclude a limit.
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
    """Return True if the amplifier was saturated.

    If it reports no full scale, it was saturated if the signal stays at one of its extremes.
    """
    if full_scale is not None:
        return bool(np.abs(raw).max() >= SATURATED_SHARE * full_scale)
    return any(_longest_run(raw == extreme) >= RAIL_SAMPLES for extreme in (raw.max(), raw.min()))


def _longest_run(flags: np.typing.NDArray[np.bool_]) -> int:
    """Return the length of the longest run of True."""
    changes = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False]))))
    return int(np.diff(changes)[::2].max(initial=0))


def _onset(times: Floats, signal: Floats, rms: float) -> float:
    """Return the time at which the response begins, s; the signal exceeds the limit somewhere within the window."""
    # The noise of a restless baseline must not raise the limit above the response itself.
    limit = max(ONSET_SHARE * float(np.ptp(signal)), min(ONSET_SIGMA * rms, 0.5 * float(np.ptp(signal))))
    return float(times[np.argmax(np.abs(signal) >= limit)])
