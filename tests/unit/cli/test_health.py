"""`pcmrs health` as people read it."""

from __future__ import annotations

import io

from msgspec.structs import replace

from pcmrs.cli.health import health_table
from pcmrs.cli.tables import Terminal
from pcmrs.messages.health import Health, HealthFacts, TaskStanding
from pcmrs.service.health.report import report
from tests.support.health_facts import WELL


def shown(facts: HealthFacts) -> str:
    console = Terminal(width=120, file=io.StringIO(), highlight=False)
    health: Health = report(facts)
    console.print(health_table(health))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def line(text: str, start: str) -> list[str]:
    (found,) = [line.split() for line in text.splitlines() if line.split()[:1] == [start]]
    return found


def test_healthy_daemon_is_shown_with_its_numbers() -> None:
    text = shown(WELL)
    assert text.startswith("ok: ratms 1.0.0 (0123456789ab), pcmrs 0.1.0, up 1:02:05\n")
    assert "→" not in text
    assert line(text, "robot") == ["robot", "yes", "0.020", "0.010", "beats", "3", "sim", "1"]
    assert line(text, "emg") == ["emg", "yes", "-", "-", "none", "elsewhere"]
    assert "accepted 9, rejected 10, failed 0, unknown 0; rejected for busy 10" in text
    assert "3 commands: p50 100.0 ms, p99 400.0 ms" in text
    assert "bus 2 of 256, journal 1 of 4096" in text
    assert "bus 5, bus.replaced 8" in text


def test_each_reason_has_its_remedy_and_markup_is_shown_as_text() -> None:
    tasks = [TaskStanding(name="[red]", answers=False, restarts=0)]
    text = shown(replace(WELL, tasks=tasks, metrics="Port [1] is taken.", latched=True))
    first, task, restart, metrics, port, *_ = text.splitlines()
    assert first.startswith("failed: ")
    assert task == "failed: task_stuck: The daemon's task '[red]' is stuck."
    assert restart.strip() == "→ Restart the daemon."
    assert metrics == "degraded: metrics_not_served: Port [1] is taken."
    assert port.strip().startswith("→ Give another")
    assert line(text, "[red]") == ["[red]", "NO", "0"]
    assert line(text, "stop") == ["stop", "latched"]
