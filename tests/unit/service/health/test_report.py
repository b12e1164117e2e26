"""The verdict on a daemon's facts: what makes it ill, how ill, and when only a restart helps."""

from __future__ import annotations

import re
from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.messages.health import (
    DeviceStatus,
    HealthFacts,
    JournalStatus,
    LoopStatus,
    NodeStatus,
    QueueStatus,
    Room,
    TaskStanding,
)
from pcmrs.service.health.report import SILENCE, SLOW_DISK, STUCK_DISK, needs_restart, reasons, report
from pcmrs.service.watches.stall import STALL
from tests import ROOT
from tests.support.health_facts import WELL

DOCS = ROOT / "docs" / "health.md"


GONE = DeviceStatus(device="tracker", connected=False, text="Nothing listens there.", heard=0.1)


SILENT = DeviceStatus(device="robot", connected=True, heard=SILENCE + 0.1)


GIVEN_UP = NodeStatus(driver="ndi", devices=["tracker"], restarts=3, given_up=True)


STUCK = TaskStanding(name="reference watch", answers=False, restarts=0)


def ill(**changes: Any) -> HealthFacts:
    return replace(WELL, **changes)


def journal(wait: float, failure: str = "", room: Room = "enough") -> JournalStatus:
    return JournalStatus(waiting=1, oldest_wait=wait, failure=failure, free=5e7, room=room)


def queue(depth: int) -> list[QueueStatus]:
    return [QueueStatus(queue="commands", depth=depth, limit=10)]


ILLNESSES: list[tuple[HealthFacts, str, str, str]] = [
    (ill(in_doubt=True), "failed", "hold_not_confirmed", "not confirmed"),
    (ill(fail_stop="internal_error: It broke."), "failed", "fail_stop", "It broke."),
    (ill(journal=journal(0.0, "No space left.")), "failed", "journal_failed", "No space left."),
    (ill(journal=journal(STUCK_DISK + 1)), "failed", "journal_stuck", "11.0 s"),
    (ill(journal=journal(SLOW_DISK + 1)), "degraded", "journal_slow", "2.0 s"),
    (ill(journal=journal(0.0, room="little")), "degraded", "disk_filling", "50 MB"),
    (ill(journal=journal(0.0, room="none")), "failed", "disk_full", "no state change"),
    (ill(tasks=[*WELL.tasks, STUCK]), "failed", "task_stuck", "'reference watch'"),
    (ill(nodes=[GIVEN_UP]), "failed", "node_given_up", "tracker"),
    (ill(devices=[GONE]), "degraded", "device_not_connected", "Nothing listens there."),
    (ill(devices=[SILENT]), "degraded", "node_silent", "robot"),
    (ill(loop=LoopStatus(lag=STALL + 0.1, stalls=1, longest=0.3)), "degraded", "loop_late", "0.30 s"),
    (ill(queues=queue(8)), "degraded", "queue_filling", "8 wait in the queue 'commands'"),
    (ill(recording="status 2"), "degraded", "recording_ended", "status 2"),
    (ill(console="status 3"), "degraded", "console_ended", "status 3"),
    (ill(certificate=7200.0), "degraded", "certificate_ends", "in 2 h"),
    (ill(metrics="Port 1 cannot be bound."), "degraded", "metrics_not_served", "Port 1"),
]
"""Facts, the verdict, its code, and a part of what is said."""


def test_healthy_daemon_has_no_reasons_and_keeps_its_facts() -> None:
    health = report(WELL)
    assert (health.status, health.reasons) == ("ok", [])
    assert [getattr(health, name) for name in HealthFacts.__struct_fields__] == [
        getattr(WELL, name) for name in HealthFacts.__struct_fields__
    ]


@pytest.mark.parametrize(("facts", "status", "code", "said"), ILLNESSES)
def test_each_fault_is_one_reason_with_finding_and_remedy(
    facts: HealthFacts, status: str, code: str, said: str
) -> None:
    health = report(facts)
    (reason,) = health.reasons
    assert (health.status, reason.severity, reason.code) == (status, status, code)
    assert said in reason.text
    assert reason.remedy
    assert needs_restart(health.reasons) == (code in ("task_stuck", "journal_stuck"))


@pytest.mark.parametrize(
    "facts",
    [
        ill(latched=True),
        ill(journal=journal(SLOW_DISK)),
        ill(devices=[DeviceStatus(device="robot", connected=True, heard=SILENCE)]),
        ill(loop=LoopStatus(lag=STALL, stalls=9, longest=5.0)),
        ill(queues=queue(7)),
        ill(strays=5, dropped={"bus.replaced": 10_000}),
    ],
)
def test_past_or_tolerated_conditions_are_no_fault(facts: HealthFacts) -> None:
    assert report(facts).status == "ok"


def test_failed_journal_is_reported_once_despite_the_fail_stop() -> None:
    facts = ill(journal=journal(STUCK_DISK + 1, "No space left."), fail_stop="journal_unavailable: No space left.")
    assert [reason.code for reason in reasons(facts)] == ["journal_failed"]


def test_devices_of_a_node_given_up_are_not_reported_again() -> None:
    facts = ill(nodes=[GIVEN_UP], devices=[GONE])
    assert [reason.code for reason in reasons(facts)] == ["node_given_up"]


def test_devices_of_a_silent_node_are_one_reason() -> None:
    """They are not reported as disconnected."""
    silent = [replace(SILENT, device=name, connected=name == "robot") for name in ("robot", "emg")]
    (reason,) = reasons(ill(devices=silent))
    assert reason.code == "node_silent"
    assert "robot, emg" in reason.text


def test_the_worst_comes_first_and_decides() -> None:
    health = report(ill(devices=[GONE], tasks=[STUCK]))
    assert [reason.severity for reason in health.reasons] == ["failed", "degraded"]
    assert health.status == "failed"


def test_the_table_in_the_documentation_is_the_one_of_the_code() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (failed|degraded) \|", DOCS.read_text(), re.MULTILINE)
    assert sorted(rows) == sorted((code, status) for _, status, code, _ in ILLNESSES)
