"""Faults of order: what was sent earlier arrives later, while Stop, an event or another command comes between."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import numpy as np

from pcmrs.campaign.checks import confirmed, expect, held
from pcmrs.campaign.delays import Delayed, Rule
from pcmrs.campaign.driving import PATIENCE, accept, said, to_retracted
from pcmrs.campaign.fault import Evidence, fault
from pcmrs.campaign.lab import REAL_TIME, Lab, LabCell
from pcmrs.messages import JointState, Verdict

LATE = 0.25
"""A late frame arrives after this, s of the machine: longer than the arm takes to confirm a hold, shorter than the time
after which a device refuses a request for its age alone."""

LOOK = 1.0
"""After the last late frame has arrived, s of the machine: what it would move has begun to move."""

STANDS = 2e-3
"""A joint that has gone less than this stands, rad."""


@asynccontextmanager
async def standing(cell: LabCell) -> AsyncIterator[list[float]]:
    """No joint moves during the context and `LOOK` after it; yields where the displacement is put, rad."""
    found: list[float] = []
    seen: list[np.ndarray] = []
    end = cell.client.listen("state/joints", JointState, lambda joints: seen.append(np.asarray(joints.positions)))
    try:
        yield found
        await asyncio.sleep(LOOK)
    finally:
        await end()
    expect(len(seen) > 1, "The arm's joints were not published.")
    found.append(float(np.abs(np.asarray(seen) - seen[0]).max()))
    expect(found[0] < STANDS, f"A joint has moved by {np.degrees(found[0]):.1f}° after the confirmed Stop.")


async def late_motion(lab: Lab, rule: Rule, name: str = "placement.approach") -> Evidence:
    """A motion whose request is late is stopped, Stop is confirmed, and then its request arrives."""
    async with lab.cell(*REAL_TIME, anew=False, delayed=True) as cell:
        await to_retracted(cell.client)
        async with cell.delays.delaying(rule):
            motion = asyncio.create_task(cell.client.call(name, timeout=PATIENCE))
            await cell.delays.begins(rule)
            await cell.client.stop()
            verdict = await motion
            expect(verdict.decision == "failed", f"{name} ended {verdict.decision}: {said(verdict)}.")
            async with standing(cell) as moved:
                late = await cell.delays.took_place(rule)
            await held(cell)
        await confirmed(cell)
        await accept(cell.client, name)
    return Evidence("refused; no joint moved", details(late, moved, verdict))


def details(late: list[Delayed], moved: list[float], verdict: Verdict) -> dict[str, object]:
    """What a row has measured."""
    return {
        "delayed": len(late),
        "late_s": [round(each.ended - each.begun, 3) for each in late],
        "overtaken": sum(each.overtaken for each in late),
        "moved_deg": [round(float(np.degrees(each)), 3) for each in moved],
        "verdict": verdict.decision,
        "control": "accepted after it was confirmed",
    }


@fault("Q1", how="the thread that sends the request of a motion is slow")
async def sent_late(lab: Lab) -> Evidence:
    """The daemon's own thread sends `follow` late."""
    return await late_motion(lab, Rule("send", "dev/robot/cmd", "follow", LATE))


@fault("Q1", how="the bus delivers the request of a motion late")
async def delivered_late(lab: Lab) -> Evidence:
    """`follow` is on its way for longer than the hold that was sent after it."""
    return await late_motion(lab, Rule("receive", "dev/robot/cmd", "follow", LATE))
