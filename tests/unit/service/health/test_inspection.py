"""Facts of a daemon are those of its parts: devices that have spoken, queues, and an end that is no fault."""

from __future__ import annotations

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest

from pcmrs.dispatcher.dispatcher import ENDING
from pcmrs.errors import JournalError
from pcmrs.messages import BlueprintTag, DeviceHealth, Reason
from pcmrs.messages.health import Health
from pcmrs.service.health.inspection import Inspection
from pcmrs.service.watches.space import MEGABYTE
from pcmrs.testing.clock import ManualClock

COUNTERS = {
    "bus.waiting": 3,
    "bus.refused": 1,
    "bus.answering": 2,
    "bus.replaced": 4,
    "bus.not_sealed": 0,
    "bus.ignored": 2,
}


class Room:
    """The parts of a daemon whose nodes serve a robot and a pointer; a tracker's node runs on another machine."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        now = self.clock.monotonic()
        self.broken: Reason | None = None
        self.credentials: Any = None
        self.reported: dict[str, DeviceHealth] = {}
        self.beats: dict[str, float] = {}
        self.data: dict[str, float] = {}
        self.rejections = Counter[str]()
        self.tasks: list[Any] = []
        self.journal = SimpleNamespace(waiting=0, oldest_wait=0.0, broken=None)
        self.space = SimpleNamespace(free=None, room="enough")
        self.nodes = SimpleNamespace(restarts={}, given_up=set())
        self.bus = SimpleNamespace(counters=lambda: COUNTERS, settings=self)
        metrics = SimpleNamespace(decisions=Counter(), rejections=self.rejections, latencies=list)
        procedure = SimpleNamespace(latched=False)
        dispatcher = SimpleNamespace(procedure=procedure, in_doubt=False, waiting=5)
        self.procedure = SimpleNamespace(
            dispatcher=dispatcher,
            command_metrics=metrics,
            health=SimpleNamespace(last=self.reported),
            beat_times=self.beats,
            data_times=self.data,
            misnamed=0,
            cell=SimpleNamespace(poses=SimpleNamespace(dropped={"old": 2})),
        )
        fine = SimpleNamespace(ended="")
        counters = SimpleNamespace(received=10, refused=1, overflowed=0)
        fields: dict[str, Any] = {
            "machine": self.clock, "bus": self.bus, "journal": self.journal, "space": self.space,
            "supervisor": SimpleNamespace(statuses=lambda: self.tasks, strays=0), "procedure": self.procedure,
            "nodes": self.nodes, "recording": fine, "console": fine,
            "stalls": SimpleNamespace(lag=0.0, stalls=0, longest=0.0), "gateway": SimpleNamespace(counters=counters),
        }  # fmt: skip
        tag = BlueprintTag(id="ratms", version="1", hash="ab")
        drivers = {"kst": ["robot"], "ndi": ["pointer"]}
        self.inspection = Inspection(blueprint=tag, drivers=drivers, metrics_trouble=lambda: "", **fields)
        self.now = now

    def health(self) -> Health:
        self.procedure.dispatcher.broken = self.broken
        return self.inspection.health()


@pytest.fixture
def room() -> Room:
    return Room()


async def test_devices_served_here_are_listed_before_they_speak(room: Room) -> None:
    """Those of another machine appear with their first message; data alone show a device that is connected."""
    silent = room.health().devices
    assert [(each.device, each.connected, each.heard) for each in silent] == [
        ("pointer", False, None),
        ("robot", False, None),
    ]
    room.data["robot"] = room.beats["tracker"] = room.now
    room.reported["pointer"] = DeviceHealth(device="pointer", connected=False, text="unplugged")
    await room.clock.advance(2.5)
    found = {each.device: each for each in room.health().devices}
    assert list(found) == ["pointer", "robot", "tracker"]
    assert (found["robot"].connected, found["robot"].data, found["robot"].heard) == (True, 2.5, None)
    assert (found["pointer"].connected, found["pointer"].text) == (False, "unplugged")
    assert (found["tracker"].connected, found["tracker"].heard) == (False, 2.5)


@pytest.mark.parametrize(
    ("broken", "shown"),
    [
        (None, ""),
        (Reason(code=ENDING, text="The daemon is ending."), ""),
        (Reason(code="internal_error", text="A bug."), "internal_error: A bug."),
    ],
)
def test_orderly_end_is_no_failure(room: Room, broken: Reason | None, shown: str) -> None:
    room.broken = broken
    assert room.health().fail_stop == shown


def test_journal_and_disk_are_in_bytes_and_words(room: Room) -> None:
    assert room.health().journal.free is None, "before the first check"
    room.space.free, room.space.room = 50.0, "none"
    room.journal.broken = JournalError("The disk is full.")
    shown = room.health().journal
    assert (shown.free, shown.room, shown.failure) == (50.0 * MEGABYTE, "none", "The disk is full.")


def test_nodes_given_up_and_full_queues_are_shown(room: Room) -> None:
    room.nodes.restarts["kst"] = 3
    room.nodes.given_up.add("kst")
    room.rejections["queue_full"] = 7
    facts = room.health()
    assert [(each.driver, each.restarts, each.given_up) for each in facts.nodes] == [
        ("kst", 3, True),
        ("ndi", 0, False),
    ]
    queues = {each.queue: (each.depth, each.refused) for each in facts.queues}
    assert queues == {"bus": (3, 1), "answers": (2, None), "commands": (5, 7), "journal": (0, None)}
    assert all(each.depth <= each.limit for each in facts.queues)
    assert facts.dropped["pose.old"] == 2


async def test_uptime_and_certificate_follow_their_clocks(room: Room) -> None:
    room.credentials = SimpleNamespace(ends=room.clock.wall() + 86400.0)
    await room.clock.advance(600.0)
    facts = room.health()
    assert (facts.uptime, facts.certificate) == (600.0, 85800.0)
