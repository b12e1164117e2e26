"""Operations of workflows that treat: in their order, confirmed by somebody, and none after a refusal."""

from __future__ import annotations

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs_lab.experiment.treatment import CONFIRMED, Treated, prepare, treat
from tests.unit.lab.scripted_client import ScriptedClient, rejected

STEPS = ["start_drilling", "confirm_drilled", "check_guide", "start_injection", "confirm_injected"]


async def test_bone_is_drilled_checked_and_injected_in_this_order() -> None:
    client = ScriptedClient(treatment="idle")
    client.leads["treatment.start_drilling"] = {"treatment": "drilling"}
    client.results["treatment.check_guide"] = {"translation_error": 1e-4}
    done = await treat(client.as_client, "femoroplasty")
    assert [step.operation for step in done] == [f"treatment.{name}" for name in STEPS]
    assert done[0] == Treated("treatment.start_drilling", "drilling", {})
    assert done[2].result == {"translation_error": 1e-4}
    assert [arguments for _, arguments in client.calls] == [CONFIRMED, CONFIRMED, {}, CONFIRMED, CONFIRMED]


async def test_a_refused_step_ends_the_treatment() -> None:
    client = ScriptedClient(treatment="drilled")
    client.answers["treatment.check_guide"] = [rejected("guide_moved")]
    with pytest.raises(CommandRefusedError, match=r"treatment\.check_guide was rejected in drilled: It is guide_moved"):
        await treat(client.as_client, "femoroplasty")
    assert client.asked[-1] == "treatment.check_guide"


async def test_an_unknown_outcome_without_reason_is_no_success() -> None:
    client = ScriptedClient(treatment="drilling")
    client.answers["treatment.confirm_drilled"] = [("unknown", None)]
    with pytest.raises(CommandRefusedError, match="was unknown in drilling: unknown"):
        await treat(client.as_client, "femoroplasty")


@pytest.mark.parametrize("workflow", ["ratms", "grid_mapping"])
async def test_other_workflows_neither_prepare_nor_treat(workflow: str) -> None:
    client = ScriptedClient()
    assert await prepare(client.as_client, workflow) == await treat(client.as_client, workflow) == []
    assert client.asked == []


async def test_clear_bone_is_confirmed_before_the_first_motion() -> None:
    client = ScriptedClient(treatment="idle")
    assert [step.operation for step in await prepare(client.as_client, "femoroplasty")] == ["treatment.confirm_clear"]
