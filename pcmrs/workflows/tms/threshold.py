"""Hunt for the motor threshold at the planned pose."""

from __future__ import annotations

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.tms.data import Response, Run
from pcmrs.workflows.tms.intensity import check_intensity, set_intensity


class AskedHunt(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `threshold.begin`.

    Attributes:
        method: Method of the hunt; None for the configured one.
    """

    method: ThresholdMethod | None = None


def hunt_possible(run: Run) -> None:
    """Prepare a hunt below the ceiling, or refuse if there is no ceiling or no room below it."""
    settings, ceiling = run.cell.settings.stimulation.threshold, run.data.ceiling
    if ceiling is None:
        text = "No ceiling of the intensity has been set: an operator must send stimulation.set_ceiling."
        raise RefusalError("no_ceiling", text)
    within = {"ceiling": min(settings.ceiling, ceiling.percent), "method": run.payload.method or settings.method}
    try:
        changed = msgspec.convert(msgspec.to_builtins(settings) | within, ThresholdSettings)
    except msgspec.ValidationError as error:
        text = f"No threshold can be hunted below the ceiling of {ceiling.percent:g} %: {error}. Have it changed."
        raise RefusalError("ceiling_too_low", text, ceiling=ceiling.percent) from None
    run.prepared = MotorThresholdEstimator.begin(changed)


def begin_hunt(run: Run) -> None:
    """Put the hunt in force."""
    hunt: MotorThresholdEstimator = run.prepared
    run.keep(hunt=hunt, threshold=None)
    run.result |= {"method": hunt.settings.method, "next": hunt.next_intensity()}


def hunted_intensity_allowed(run: Run) -> None:
    """Refuse an intensity above a ceiling that was lowered since, or one that the operator has not dialled yet."""
    percent = _hunt_of(run).next_intensity()
    check_intensity(run.data, percent)
    if run.cell.settings.stimulation.dialled and run.data.intensity != percent:
        text = f"The hunt needs {percent:g} %: turn the dial to it, and report it by stimulation.set_intensity."
        raise RefusalError("not_dialled", text, percent=percent, intensity=run.data.intensity)


async def set_hunted_intensity(run: Run) -> None:
    """Set the intensity that the hunt needs next."""
    await set_intensity(run, _hunt_of(run).next_intensity())


def learn_threshold(run: Run) -> None:
    """Add the response to the hunt, and decide its outcome. A pulse without a valid response is repeated."""
    response: Response = run.prepared
    hunt = _hunt_of(run)
    if response.mep is not None and not response.problem:
        amplitude = response.mep.peak_to_peak
        responded = amplitude * 1e6 >= hunt.settings.response_uv
        hunt = hunt.after(run.data.intensity or 0.0, responded, amplitude)
        run.keep(hunt=hunt)
        run.result["responded"] = responded
    run.outcome = _outcome(hunt)
    if run.outcome == "found":
        run.keep(threshold=hunt.estimate)
    extra = {"next": hunt.next_intensity()} if run.outcome == "hunting" else {}
    run.result |= {"estimate": msgspec.to_builtins(hunt.estimate), "pulses": len(hunt.pulses), **extra}
    if run.outcome == "none":
        run.result["refusal"] = hunt.refusal


def _outcome(hunt: MotorThresholdEstimator) -> str:
    if hunt.finished:
        return "found"
    return "hunting" if hunt.refusal is None else "none"


def _hunt_of(run: Run) -> MotorThresholdEstimator:
    """Return the active hunt. Raises `RefusalError` if there is none."""
    if run.data.hunt is None:
        raise RefusalError("no_hunt", "There is no hunt for a threshold: send threshold.begin first.")
    return run.data.hunt


def register_threshold(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    registry.payload("threshold_hunt", AskedHunt)
    for check in (hunt_possible, hunted_intensity_allowed):
        registry.check(check)
    for step in (begin_hunt, learn_threshold):
        registry.step(step)
    registry.world_step(set_hunted_intensity)
