"""Steps of the trains of pulses: they count; when the next pulse may come is for the timers of the blueprint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from pcmrs.dispatcher import Registry, Run
from pcmrs.fsm import Effect
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData
from pcmrs.workflows.data import settle as settle_placement


class Data(PlacementData, frozen=True, kw_only=True):
    """Data of the procedure besides landmarks, registration and plan.

    Attributes:
        placements: Number of placements since the registration was made or validated.
        pulses: Number of pulses in the present train.
    """

    placements: int = 0
    pulses: int = 0


def count_placement(run: Run[Cell, Data]) -> None:
    """Count a placement; the last one that the registration is good for posts that it must be validated again."""
    count, limit = run.data.placements + 1, run.cell.settings.limits["placements"]
    run.keep(placements=count)
    run.result["placements"] = count
    if count >= limit:
        run.post("validity", "expire")


def begin_train(run: Run[Cell, Data]) -> None:
    """Count the pulses of a new train."""
    run.keep(pulses=0)


def count_pulse(run: Run[Cell, Data]) -> None:
    """Count a pulse that is given by hand; after the last one of a train, the pause between trains follows."""
    count = run.data.pulses + 1
    is_last = count >= run.cell.settings.limits["pulses_in_train"]
    run.keep(pulses=0 if is_last else count)
    run.outcome = "pausing" if is_last else "resting"
    run.result["pulse"] = count


def settle(data: Data, states: Mapping[str, str], effects: Sequence[Effect]) -> PlacementData:
    """Fit the data to a commit: a registration that becomes valid has no placements yet."""
    renewed = any(effect.branch == "validity" and effect.target == "valid" for effect in effects)
    data = msgspec.structs.replace(data, placements=0) if renewed else data
    return settle_placement(data, states, effects)


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Register the functions under their own names, which timed_pulses.toml uses. The daemon calls this."""
    for step in (count_placement, begin_train):
        registry.step(step)
    registry.world_step(count_pulse, affects_patient=True)
