"""A protocol of few sentences, and answers to it that tests have made: right, slightly wrong, and others."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from pcmrs.authoring.drafting.client import ModelClient
from pcmrs.authoring.drafting.model import ModelSettings
from pcmrs.clock import SystemClock

REGISTERED = "The surgeon registers the patient."
ALIGNED = "The robot aligns the guide with the planned path only if the patient is registered."
INSERTED = "After a confirmation, the surgeon inserts the needle once."
NEVER = "The needle is never inserted unless the guide is aligned and the patient is registered."
PROTOCOL = f"# Bone biopsy\n\n{REGISTERED} {ALIGNED}\n{INSERTED}\n\n{NEVER}\n"


def step(name: str, operation: str, source: str, *needs: str, **keys: Any) -> dict[str, Any]:
    return {"name": name, "operation": operation, "source": source, "depends_on": list(needs), **keys}


def right() -> dict[str, Any]:
    """The right answer, as an object."""
    inserted = {"affects_patient": True, "irreversible": True, "confirm": True}
    return {
        "id": "bone_biopsy",
        "title": "Bone biopsy",
        "steps": [
            step("registered", "register", REGISTERED, moves=False, title=""),
            step("aligned", "align", ALIGNED, "registered", moves=True, reopened_by=["withdraw"]),
            step("inserted", "insert", INSERTED, "aligned", **inserted, moves=None, refined_by=None),
        ],
        "requirements": [
            {"id": "ready", "source": NEVER, "operation": "insert", "step": "", "holds": ["aligned", "registered"]}
        ],
        "assumptions": [{"text": "The guide stays at the path.", "source": ALIGNED}],
        "questions": ["Who confirms the insertion?"],
    }


def changed(change: Any) -> str:
    """The right answer after a change, as a model sends it."""
    answer = right()
    change(answer)
    return json.dumps(answer)


def forget_alignment(answer: dict[str, Any]) -> None:
    """Slightly wrong: the insertion depends on the registration alone, so the requirement does not hold."""
    answer["steps"][2]["depends_on"] = ["registered"]


RIGHT = json.dumps(right())
SLIGHTLY_WRONG = changed(forget_alignment)


class PauselessClock(SystemClock):
    """A clock whose pauses end at once, and are noted."""

    def __init__(self) -> None:
        super().__init__()
        self.pauses: list[float] = []

    async def sleep(self, seconds: float) -> None:
        self.pauses.append(seconds)


class Asked:
    """A client with its notes."""

    def __init__(self, client: ModelClient, clock: PauselessClock, lines: list[str]) -> None:
        self.client, self.clock, self.lines = client, clock, lines


@asynccontextmanager
async def asking(url: str, *, key: str = "", **limits: Any) -> AsyncIterator[Asked]:
    """Open a client of a server, which makes no pauses between attempts."""
    settings = msgspec.structs.replace(ModelSettings(url=url, model="made"), **limits)
    clock, lines = PauselessClock(), list[str]()
    async with ModelClient.open(settings, key, clock, lines.append) as client:
        yield Asked(client, clock, lines)
