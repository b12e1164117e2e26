"""The operator of a session: a request that is too early is repeated, and a coil that cannot get there is given up."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import CommandRefusedError
from pcmrs.messages import Reason
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.experiment.session import operator as operating
from pcmrs_lab.experiment.session.operator import SessionOperator
from tests.unit.lab.scripted_client import ScriptedClient, failed, rejected, snapshot, verdict


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> ScriptedClient:
    monkeypatch.setattr(operating, "PAUSE", 0.001)
    made = ScriptedClient(placement="placed", stimulation="disarmed")
    made.leads = {
        "placement.locate": {"placement": "retracted"},
        "placement.approach": {"placement": "standoff"},
        "placement.confirm": {"placement": "placed"},
        "placement.back_off": {"placement": "retracted"},
        "stimulation.arm": {"stimulation": "armed"},
    }
    return made


def operator(client: ScriptedClient) -> SessionOperator:
    return SessionOperator(client.as_client, rate=1000.0)


async def test_temporary_rejection_is_waited_out(client: ScriptedClient) -> None:
    client.answers["hotspot.pulse"] = [
        rejected("not_aligned"),
        rejected("pulse_too_soon", wait=4.0),
        ("accepted", None),
    ]
    assert (await operator(client).request("hotspot.pulse")).decision == "accepted"
    assert client.asked == ["hotspot.pulse"] * 3


async def test_permanent_rejection_raises(client: ScriptedClient) -> None:
    client.answers["hotspot.pulse"] = [rejected("too_many_pulses")]
    with pytest.raises(CommandRefusedError, match=r"hotspot\.pulse was rejected .*It is too_many_pulses"):
        await operator(client).request("hotspot.pulse")


async def test_patience_ends(client: ScriptedClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operating, "PATIENCE", 0.0)
    client.answers["hotspot.pulse"] = [rejected("not_aligned")] * 50
    with pytest.raises(CommandRefusedError, match="not_aligned"):
        await operator(client).request("hotspot.pulse")


async def test_the_coil_is_brought_to_its_place_from_anywhere(client: ScriptedClient) -> None:
    client.branches["placement"] = "unknown"
    await operator(client).place()
    assert client.asked == ["placement.locate", "placement.approach", "placement.confirm"]


async def test_failed_motion_is_repeated_up_to_a_limit(client: ScriptedClient) -> None:
    client.branches["placement"] = "standoff"
    client.answers["placement.confirm"] = [failed("pose_missing_frames", "Too few.")]
    await operator(client).place()
    assert client.asked == ["placement.confirm", "placement.confirm"]
    client.branches["placement"] = "standoff"
    client.answers["placement.confirm"] = [rejected("out_of_reach")] * 9
    with pytest.raises(CommandRefusedError, match="out_of_reach"):
        await operator(client).place()


async def test_a_latch_is_acknowledged(client: ScriptedClient) -> None:
    client.branches["placement"], client.latched = "held", True
    client.leads["placement.back_off"] = {"placement": "placed"}
    await operator(client).place()
    assert client.asked == ["robot.acknowledge", "placement.back_off"]


async def test_lasting_latch_is_reported_with_its_cause(client: ScriptedClient) -> None:
    client.branches["placement"], client.latched = "held", True
    client.answers["placement.back_off"] = [failed("link_lost", "The link is lost.")]
    client.answers["robot.acknowledge"] = [("accepted", None), rejected("invalid_in_state")]
    with pytest.raises(CommandRefusedError, match=r"back_off was failed in held: The link is lost\."):
        await operator(client).place()


async def test_stimulator_that_disarmed_by_itself_is_rearmed(client: ScriptedClient) -> None:
    client.answers["threshold.pulse"] = [rejected("not_armed"), ("accepted", None)]
    client.leads["stimulation.arm"] = {}  # it does not stay so
    await operator(client).fire("threshold.pulse")
    assert client.asked == ["stimulation.arm", "threshold.pulse"] * 2


async def test_a_pulse_of_unknown_outcome_is_not_given_again(client: ScriptedClient) -> None:
    client.answers["threshold.pulse"] = [("unknown", Reason(code="unknown_outcome", text="No answer."))]
    with pytest.raises(CommandRefusedError, match="unknown"):
        await operator(client).fire("threshold.pulse")
    assert client.asked.count("threshold.pulse") == 1


async def test_withdrawing_disarms_first(client: ScriptedClient) -> None:
    client.leads["placement.back_off"] = {"placement": "standoff"}
    await operator(client).withdraw()
    assert client.asked == ["stimulation.disarm", "placement.back_off", "placement.home"]


async def test_a_way_home_that_leads_past_the_body_begins_farther_away(client: ScriptedClient) -> None:
    client.branches["placement"] = "standoff"
    client.answers["placement.home"] = [rejected("distance_shrinks")]
    client.leads["toolplan.clear"] = {"placement": "held"}
    await operator(client).withdraw()
    assert client.asked[-3:] == ["toolplan.clear", "placement.back_off", "placement.home"]


async def test_a_coil_that_cannot_go_home_stays_clear_of_the_body(client: ScriptedClient) -> None:
    client.answers["placement.home"] = [rejected("distance_shrinks")] * 2
    await operator(client).withdraw()
    assert client.branches["placement"] == "retracted"


async def test_an_arm_that_gets_nowhere_is_given_up(client: ScriptedClient) -> None:
    client.branches["placement"] = "held"
    client.leads["placement.back_off"] = {"placement": "held"}
    with pytest.raises(CommandRefusedError, match="back_off"):
        await operator(client).place()


def test_the_least_time_between_two_pulses_is_kept(client: ScriptedClient) -> None:
    client.branches["stimulation"] = "armed"

    async def fire_thrice() -> list[float]:
        patient, fired = SessionOperator(client.as_client, rate=100.0, interval=2.0), list[float]()
        for _ in range(3):
            await patient.fire("hotspot.pulse")
            fired.append(asyncio.get_running_loop().time())
        return fired

    assert run_on_simulated_loop(fire_thrice()) == pytest.approx([0.0, 0.02, 0.04])


async def test_pulse_waits_until_the_coil_is_shown_aligned(client: ScriptedClient) -> None:
    client.branches |= {"stimulation": "armed", "alignment": "0"}
    firing = asyncio.create_task(operator(client).fire("hotspot.pulse"))
    await asyncio.sleep(0.01)
    assert client.asked == []
    client.handlers["state/fsm"](snapshot(alignment="0"))
    await asyncio.sleep(0)
    assert client.asked == []
    client.handlers["state/fsm"](snapshot(alignment="1"))
    assert (await firing).decision == "accepted"


def test_refusal_without_a_reason_says_so() -> None:
    assert operating.refused(verdict("hotspot.pulse", "unknown", state="armed")).text == (
        "hotspot.pulse was unknown in armed: the reason is unknown."
    )
