"""Search and hunt of `ratms_threshold` together: every pulse has all conditions, and the verifier proves them."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.fsm import examine
from pcmrs.workflows import find_workflow, read_workflow
from tests.unit.workflows.stimulation_bench import StimulationBench


async def test_search_and_hunt_exclude_each_other(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    await armed.refuse("hotspot.begin", "hunt_under_way")
    await armed.accept("threshold.abandon")
    await armed.accept("hotspot.begin")
    await armed.refuse("threshold.begin", "search_under_way")


@pytest.mark.parametrize("name", ["hotspot", "threshold"])
async def test_every_way_to_a_pulse_has_all_its_conditions(armed: StimulationBench, name: str) -> None:
    await armed.accept(f"{name}.begin")
    await armed.accept("stimulation.disarm")
    await armed.refuse(f"{name}.pulse", "not_armed")
    await armed.accept("stimulation.arm")
    await armed.rest()
    await armed.accept(f"{name}.pulse")
    await armed.refuse(f"{name}.pulse", "pulse_too_soon")
    await armed.rest()
    armed.bench.cell.emg = None
    await armed.refuse(f"{name}.pulse", "no_emg")
    armed.bench.cell.emg = armed.emg
    await armed.bench.scene.occlude("coil", hidden=True)
    await armed.until(lambda: armed.states["alignment"] == "0")
    await armed.refuse(f"{name}.pulse", "not_aligned")
    assert len(armed.stimulator.fired) == 1


@pytest.mark.parametrize("name", ["hotspot", "threshold"])
async def test_unknown_pulse_of_a_search_disarms_and_is_not_counted(armed: StimulationBench, name: str) -> None:
    await armed.accept(f"{name}.begin")
    armed.stimulator.mute.add("fire")
    assert (await armed.do(f"{name}.pulse")).decision == "unknown"
    await armed.until(lambda: armed.states["stimulation"] == "disarmed")
    assert len(armed.stimulator.fired) == 1
    kept = armed.data.search if name == "hotspot" else armed.data.hunt
    assert kept.pulses == ()
    armed.stimulator.mute.clear()
    await armed.accept("stimulation.arm")
    await armed.refuse(f"{name}.pulse", "pulse_too_soon")
    await armed.rest()
    await armed.accept(f"{name}.pulse")
    assert [number for number, _, _ in armed.stimulator.fired] == [1, 2]
    assert armed.data.given == 2


async def test_two_pulses_at_once_are_one(armed: StimulationBench) -> None:
    await armed.accept("threshold.begin")
    verdicts = await asyncio.gather(armed.do("threshold.pulse"), armed.do("stimulation.fire"))
    assert [verdict.decision for verdict in verdicts].count("accepted") == 1
    assert len(armed.stimulator.fired) == 1


BLUEPRINT = find_workflow("ratms_threshold").blueprint
WEAKER = {
    "pulse_only_armed_and_aligned": (
        '[branches.threshold.operations.pulse.requires]\nstimulation = ["armed"]\nalignment = ["1"]\n',
        '[branches.threshold.operations.pulse.requires]\nstimulation = ["armed"]\n',
        '[branches.threshold.operations.pulse.refusal]\nstimulation = "not_armed"\nalignment = "not_aligned"\n',
        '[branches.threshold.operations.pulse.refusal]\nstimulation = "not_armed"\n',
    ),
    "armed_only_at_the_body": (
        'by = ["registration", "toolplan", "placement"]\nfrom = ["armed"]',
        'by = ["registration", "toolplan"]\nfrom = ["armed"]',
    ),
    "no_ceiling_while_armed": (
        'from = ["disarmed"]\nto = "disarmed"\nroles = ["operator", "teleoperator"]\npayload = "ceiling"',
        'from = ["*"]\nto = { disarmed = "disarmed", armed = "armed" }\npayload = "ceiling"',
    ),
    "disarm_always_accepted": (
        'from = ["*"]\nto = "disarmed"\nchecks = ["stimulator_there"]',
        'from = ["*"]\nto = "disarmed"\nrequires = { alignment = ["1"] }\nchecks = ["stimulator_there"]',
    ),
    "threshold_only_of_this_place": (
        'by = ["registration", "toolplan"]\nfrom = ["hunting", "found"]',
        'by = ["registration"]\nfrom = ["hunting", "found"]',
    ),
}


@pytest.mark.parametrize("promise", WEAKER)
@pytest.mark.nightly
def test_the_verifier_notices_a_weaker_rule(promise: str) -> None:
    text = BLUEPRINT.read_text()
    changes = WEAKER[promise]
    for old, new in zip(changes[::2], changes[1::2], strict=True):
        assert text.count(old) == 1
        text = text.replace(old, new)
    findings = examine(text.encode(), folder=BLUEPRINT.parent).findings
    assert promise in " ".join(finding.text for finding in findings if finding.code == "property_violated")


def test_the_workflow_extends_ratms() -> None:
    ratms, own = read_workflow("ratms"), read_workflow("ratms_threshold")
    for name, branch in ratms.branches.items():
        if name != "toolplan":
            assert own.branches[name] == branch
    assert set(own.branches) - set(ratms.branches) == {"stimulation", "hotspot", "threshold"}
    assert own.properties[: len(ratms.properties)] == ratms.properties
