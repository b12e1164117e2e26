"""What the arm keeps away from after a restart of the daemon, before anybody has registered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from pcmrs.dispatcher import Workflow
from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.spatial import Floats
from pcmrs.workflows._collision_checks import update_collision_scene
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Registered
from tests.support.shipped import shipped_workflow
from tests.unit.workflows.workflow_bench import WorkflowBench, open_bench

ASIDE = (IIWA14_R820.home[0] + 0.3, *IIWA14_R820.home[1:])
"""A home posture that the simulated arm does not start in."""


async def registered_and_at_the_body() -> tuple[Registered, Floats]:
    """A registration of the simulated head, and the joints with the tool at it."""
    async with open_bench() as bench:
        await bench.to_placed()
        assert bench.data.registered is not None
        return bench.data.registered, bench.cell.posture()


def restarted_with(previous: Registered | None) -> Workflow[Cell, PlacementData]:
    """The workflow as a daemon opens it that finds this registration in its journal."""
    shipped = shipped_workflow("ratms")
    return replace(shipped, initial=msgspec.structs.replace(shipped.initial, previous=previous))


def near_the_head(bench: WorkflowBench, posture: Floats) -> bool:
    update_collision_scene(bench.cell, bench.data)
    return bool(bench.cell.zones.near_body(np.array([posture]), 0.02)[0])


@pytest.mark.parametrize("name", ["placement.home", "placement.to_initial"])
async def test_without_any_registration_a_way_home_has_to_be_confirmed(name: str) -> None:
    async with open_bench({"home": ASIDE}) as bench:
        await bench.connect()
        refused = await bench.refuse(name, "body_not_registered")
        assert refused.reason is not None
        assert "confirm: true" in refused.reason.text
        await bench.refuse(name, "body_not_registered", confirm=False)
        accepted = await bench.accept(name, confirm=True)
        assert accepted.result is not None
        assert accepted.result["body_not_registered"]
        await bench.accept(name)  # it is there: nothing moves


async def test_once_registered_nothing_needs_confirmation() -> None:
    """Not even when the registration is given up."""
    async with open_bench({"home": ASIDE}) as bench:
        await bench.register()
        await bench.accept("registration.clear_registration")
        await bench.accept("placement.home")


async def test_previous_registration_is_only_a_zone_to_keep_out_of() -> None:
    registered, at_the_body = await registered_and_at_the_body()
    async with open_bench({"home": ASIDE}, workflow=restarted_with(registered)) as bench:
        await bench.connect()
        assert near_the_head(bench, at_the_body)
        assert not near_the_head(bench, bench.cell.posture())
        await bench.accept("placement.home")
        assert (bench.states["registration"], bench.data.registered) == ("000", None)
        assert (await bench.do("placement.approach")).decision == "rejected"
    async with open_bench({"home": at_the_body.tolist()}, workflow=restarted_with(registered)) as bench:
        await bench.connect()
        refused = await bench.do("placement.home")
        assert refused.reason is not None
        assert refused.reason.code in ("distance_shrinks", "not_clear", "zone_violated")


@pytest.mark.parametrize(
    "other", [{"patient": "somebody else"}, {"calibration": "another"}, {"reference_serial": "another"}]
)
async def test_registration_of_other_patient_or_calibration_is_ignored(other: dict[str, Any]) -> None:
    """So is that of another reference."""
    registered, at_the_body = await registered_and_at_the_body()
    previous = msgspec.structs.replace(registered, **other)
    async with open_bench({"home": ASIDE}, workflow=restarted_with(previous)) as bench:
        await bench.connect()
        assert not near_the_head(bench, at_the_body)
        await bench.refuse("placement.home", "body_not_registered")
        await bench.accept("placement.home", confirm=True)


async def test_registration_of_a_moved_reference_is_ignored() -> None:
    registered, _ = await registered_and_at_the_body()
    assert registered.reference is not None
    async with open_bench({"home": ASIDE}, workflow=restarted_with(registered)) as bench:
        await bench.scene.bump_reference((0.02, 0.0, 0.0), (0.0, 0.0, 0.0))
        await bench.connect()
        await bench.refuse("placement.home", "body_not_registered")
