"""The checks of a campaign can fail: what a cell does wrong is found, whatever it says of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag, Reason, Running, Snapshot, Verdict
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import STANDS_WITHIN, refused, unmoved

SNAPSHOT = Snapshot(
    sequence=7,
    branches={"placement": "standoff"},
    flags={},
    running=[],
    latched=False,
    blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)
REJECTED = Verdict(
    id="1",
    branch="placement",
    operation="confirm",
    decision="rejected",
    state="standoff",
    sequence=7,
    reason=Reason(code="pose_stale", text="The pose is old."),
)


@dataclass
class ScriptedCell:
    """A cell that answers as told: it stands for client and cell at once."""

    verdict: Verdict = REJECTED
    after: Snapshot = SNAPSHOT
    recorded: list[Verdict] = field(default_factory=lambda: [REJECTED])
    asked: int = 0

    @property
    def client(self) -> ScriptedCell:
        return self

    async def state(self) -> Snapshot:
        self.asked += 1
        return SNAPSHOT if self.asked == 1 else self.after

    async def call(self, name: str, arguments: object) -> Verdict:
        return self.verdict

    def last_row(self) -> int:
        return 3

    def rows(self, after: int) -> list[JournalRow]:
        assert after == 3
        return cast(list[JournalRow], [Recorded(verdict) for verdict in self.recorded])


@dataclass
class ScriptedScene:
    """A scene whose tool is at these places, one after the other."""

    places: list[tuple[float, float, float]]

    @property
    def scene(self) -> ScriptedScene:
        return self

    async def truth(self) -> Any:
        return SimpleNamespace(tracker_from_coil=SimpleNamespace(position=self.places.pop(0)))


@dataclass
class Recorded:
    verdict: Verdict


async def judge(**changed: Any) -> Verdict:
    return await refused(cast(RunningCell, ScriptedCell(**changed)), "placement.confirm", codes=("pose_stale",))


def altered(**fields: Any) -> Verdict:
    return msgspec.structs.replace(REJECTED, **fields)


async def test_a_refusal_that_changes_nothing_and_is_journalled_passes() -> None:
    assert await judge() == REJECTED
    running = [Running(branch="toolplan", operation="plan", id="2")]
    await judge(after=msgspec.structs.replace(SNAPSHOT, running=running))


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"verdict": altered(decision="accepted", reason=None)}, "must be rejected"),
        ({"verdict": altered(decision="failed")}, "must be rejected"),
        ({"verdict": altered(reason=Reason(code="busy", text="Busy."))}, "pose_stale"),
        ({"after": msgspec.structs.replace(SNAPSHOT, sequence=8)}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, latched=True)}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, branches={"placement": "placed"})}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, plan="another")}, "changed"),
        ({"recorded": []}, "journal"),
        ({"recorded": [altered(id="2")]}, "journal"),
    ],
)
async def test_anything_else_does_not(changed: dict[str, Any], word: str) -> None:
    with pytest.raises(Unmet, match=word):
        await judge(**changed)


@pytest.mark.parametrize("way", [0.0, STANDS_WITHIN / 2])
async def test_an_arm_that_stays_where_it_was_is_unmoved(way: float) -> None:
    async with unmoved(cast(RunningCell, ScriptedScene([(0.1, 0.2, 0.3), (0.1 + way, 0.2, 0.3)]))):
        pass


async def test_an_arm_that_went_anywhere_is_not() -> None:
    with pytest.raises(Unmet, match=r"moved by 1\.00 mm"):
        async with unmoved(cast(RunningCell, ScriptedScene([(0.1, 0.2, 0.3), (0.1, 0.201, 0.3)]))):
            pass
