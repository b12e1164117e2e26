"""Injections of which the outcome is known, in place of the real ones."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import DeviceError
from pcmrs.testing.errors import Unmet
from pcmrs.testing.needs import program
from pcmrs_lab.campaign import fault as registry
from pcmrs_lab.campaign.fault import Evidence, NotRun, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.sham import inject_unless_sham
from pcmrs_lab.campaign.tries import record

ONCE = {"seen": 1}
NASTY = "<script>alert('B4')</script> & \"more\""


def register(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registers rows S1 to S13 and A1 to A3, and nothing else."""
    monkeypatch.setattr(registry, "REGISTERED", {})
    monkeypatch.setattr("pcmrs_lab.campaign.run.injections", lambda: registry.REGISTERED)

    @fault("S1", how="well")
    async def well(lab: Lab) -> Evidence:
        lab.folder.joinpath("left over").write_text("x")
        drawn = {"seed": lab.seed, "drawn": lab.random.random()}
        return Evidence("as required", took_place=ONCE, control=ONCE, control_kind="without_fault", details=drawn)

    @fault("S2", how="unmet")
    async def unmet(lab: Lab) -> Evidence:
        raise Unmet(f"It moved. {NASTY}")

    @fault("S3", how="no tool here")
    async def no_tool(lab: Lab) -> Evidence:
        raise NotRun("this machine has no moon")

    @fault("S4", how="a tool that nobody has", needs=(program("sh"), program("no-such-tool-anywhere")))
    async def missing(lab: Lab) -> Evidence:
        raise AssertionError("must not be run")

    @fault("S5", how="hangs", deadline=0.05)
    async def hangs(lab: Lab) -> Evidence:
        await asyncio.Event().wait()
        raise AssertionError

    @fault("S6", how="crashes")
    async def crashes(lab: Lab) -> Evidence:
        raise DeviceError("The daemon is gone.")

    @fault("S7", how="first way")
    async def first(lab: Lab) -> Evidence:
        return Evidence("seen", took_place=ONCE, control=ONCE, control_kind="without_fault")

    @fault("S7", how="second way")
    async def second(lab: Lab) -> Evidence:
        raise Unmet("not seen")

    @fault("S8", how="can be")
    async def can_be(lab: Lab) -> Evidence:
        return Evidence("seen", took_place=ONCE, control=ONCE, control_kind="without_fault")

    @fault("S8", how="cannot be")
    async def cannot_be(lab: Lab) -> Evidence:
        raise NotRun("no disk")

    @fault("S9", how="nothing measured")
    async def unmeasured(lab: Lab) -> Evidence:
        return Evidence("as required", took_place={}, control=ONCE, control_kind="without_fault")

    @fault("S10", how="measured, and there was nothing")
    async def measured(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        return Evidence(
            "as required",
            took_place={"arrived": len(arrived)},
            control={**ONCE, "way_m": 0.1},
            control_kind="permitted",
        )

    @fault("S11", how="found out at once")
    async def found_out(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        if not arrived:
            raise Unmet("Nothing arrived.")
        return Evidence("as required", took_place=ONCE, control=ONCE, control_kind="without_fault")

    @fault("S12", how="without a control")
    async def uncontrolled(lab: Lab) -> Evidence:
        return Evidence(
            "as required", took_place=ONCE, control={"accepted": False, "way_m": float("nan")}, control_kind="mutant"
        )

    @fault("S13", how="breaks without its fault")
    async def breaks(lab: Lab) -> Evidence:
        arrived: list[int] = []
        inject_unless_sham(lambda: arrived.append(1))
        return Evidence("as required", took_place={"arrived": arrived[0]}, control=ONCE, control_kind="without_fault")

    @fault("A1", how="with another input as its control")
    async def attacked(lab: Lab) -> Evidence:
        return Evidence("refused", took_place=ONCE, control=ONCE, control_kind="without_fault")

    @fault("A3", how="tries what it declares", tries={"flood": ["UDP"]})
    async def tries_it(lab: Lab) -> Evidence:
        record("flood", "UDP")
        return Evidence("seen", took_place=ONCE, control=ONCE, control_kind="permitted")

    @fault("A2", how="declares what it does not try", tries={"flood": ["UDP"], "viewer": ["TCP"]})
    async def claims_it(lab: Lab) -> Evidence:
        record("flood", "UDP")
        return Evidence("seen", took_place=ONCE, control=ONCE, control_kind="permitted")
