"""A cell in simulated time, as people test their own workflows with it."""

from __future__ import annotations

import re
from typing import Any

import pytest

from pcmrs.errors import ConfigurationError
from pcmrs.testing.driving import landmarks, tool_pose
from pcmrs.testing.errors import Unmet
from pcmrs.testing.simulated import CellInSimulatedTime, run_simulated
from tests import ROOT

PAGE = ROOT / "docs" / "testing.md"
QUICK = ("sim.arm.physics=kinematic",)


async def to_standoff(cell: CellInSimulatedTime) -> float:
    await cell.accept("robot.connect")
    await cell.until(lambda shown: shown.branches["placement"] != "unknown" and not shown.running)
    await cell.accept("registration.plan_landmarks", **landmarks())
    await cell.accept("digitization.digitize_all")
    await cell.accept("registration.register")
    await cell.accept("toolplan.plan", **tool_pose())
    await cell.accept("placement.approach")
    assert cell.snapshot.branches["placement"] == "standoff"
    return cell.clock.monotonic()


def test_a_procedure_is_run_alike_each_time() -> None:
    first, again = (run_simulated(to_standoff, overrides=QUICK) for _ in range(2))
    assert first == again > 5.0


def test_crash_leaves_the_starting_states() -> None:
    """What is not confirmed is reported."""

    async def course(cell: CellInSimulatedTime) -> None:
        await to_standoff(cell)
        await cell.crash()
        assert cell.snapshot.branches["registration"] == "000"
        await cell.accept("robot.connect")
        await cell.accept("registration.plan_landmarks", **landmarks())
        with pytest.raises(Unmet, match=r"registration\.register was rejected: "):
            await cell.accept("registration.register")
        with pytest.raises(Unmet, match="did not come within 2 s"):
            await cell.until(lambda shown: shown.branches["placement"] == "placed", within=2.0)

    run_simulated(course, overrides=QUICK)


def test_an_acknowledgement_names_the_stop_that_is_shown() -> None:
    async def course(cell: CellInSimulatedTime) -> None:
        await to_standoff(cell)
        await cell.scene.inject("e_stop", {"on": True})
        await cell.until(lambda shown: shown.latched)
        await cell.scene.inject("e_stop", {"on": False})
        await cell.until(lambda shown: not shown.stop.pending)
        await cell.accept("robot.acknowledge")
        assert not cell.snapshot.latched

    run_simulated(course, overrides=QUICK)


def test_an_unknown_workflow_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="nowhere"):
        run_simulated(to_standoff, workflow="nowhere")


def test_the_example_of_the_page_passes() -> None:
    (example,) = re.findall(r"^## A workflow.*?^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    found: dict[str, Any] = {}
    exec(example, found)
    found["test_a_registration_needs_digitized_landmarks"]()
