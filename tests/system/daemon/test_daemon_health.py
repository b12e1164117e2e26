"""A real daemon under a service manager, scraped and asked how it is: well, blocked, with a task that hangs, ending."""

from __future__ import annotations

import json
import os
import signal
import socket
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept
from tests.system.daemon.daemon_process import (
    PATIENCE,
    ServeProcess,
    own_settings,
    running_daemon,
    wait_until,
)
from tests.system.daemon.service_manager import ServiceManager

TROUBLE = """
import os, signal, time

def block(*_):
    open(os.environ["PCMRS_TEST_BLOCKED"], "w").close()
    while os.path.exists(os.environ["PCMRS_TEST_BLOCKED"]):
        time.sleep(0.01)

def hang(*_):
    import pcmrs.service.watches.reference
    pcmrs.service.watches.reference.PERIOD = 1e9

signal.signal(signal.SIGUSR1, block)
signal.signal(signal.SIGUSR2, hang)
"""
"""SIGUSR1 blocks the loop until a file is removed; SIGUSR2 has the task `reference watch` wait for ever."""


@pytest.fixture
def manager(monkeypatch: pytest.MonkeyPatch) -> Iterator[ServiceManager]:
    made = ServiceManager()
    monkeypatch.setenv("NOTIFY_SOCKET", made.address)
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    yield made
    made.close()


@pytest.fixture
def blocked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "sitecustomize.py").write_text(TROUBLE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("PCMRS_TEST_BLOCKED", str(tmp_path / "blocked"))
    return tmp_path / "blocked"


def scrape(daemon: ServeProcess) -> dict[tuple[str, tuple[str, ...]], float]:
    with urllib.request.urlopen(daemon.ready.metrics, timeout=PATIENCE) as answer:
        text = answer.read().decode()
    return {
        (sample.name, tuple(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_daemon_notifies_and_is_scraped_unless_it_is_blocked(
    tmp_path: Path, manager: ServiceManager, blocked: Path
) -> None:
    with running_daemon([*own_settings(tmp_path), *LIGHT, "metrics.port=0"], tmp_path) as daemon:
        assert manager.next() == {"READY": "1"}
        fed = manager.next()
        assert fed["WATCHDOG"] == "1"
        assert fed["STATUS"].partition(":")[0] in ("ok", "degraded")

        async with daemon.client() as client:
            await accept(client, "robot.connect")
            assert (await client.call("robot.connect")).decision == "rejected"
            health = await client.health()
        told = scrape(daemon)
        assert told["pcmrs_loop_answers", ()] == 1
        assert health.rejections == {"invalid_in_state": 1}
        assert told["pcmrs_rejections_total", ("invalid_in_state",)] == 1
        assert told["pcmrs_decision_latency_seconds_count", ("rejected",)] == 1
        for device in ("robot", "tracker"):
            assert told["pcmrs_device_connected", (device,)] == 1
            assert ("pcmrs_device_data_age_seconds", (device,)) in told

        daemon.process.send_signal(signal.SIGUSR1)
        assert wait_until(blocked.exists)
        manager.waiting()  # sent before
        assert {name for name, _ in scrape(daemon) if name.startswith("pcmrs_")} == {"pcmrs_loop_answers"}
        assert manager.waiting() == []
        os.unlink(blocked)  # noqa: PTH108  a blocking call, as all of this test
        manager.until("WATCHDOG")
        assert scrape(daemon)["pcmrs_loop_stalls_total", ()] >= 1

        daemon.process.send_signal(signal.SIGTERM)
        manager.until("STOPPING")
        assert daemon.process.wait(PATIENCE) == 0
        assert not any("ending" in message.get("STATUS", "") for message in manager.waiting()), "that is no failure"
        assert "Traceback" not in daemon.log


@pytest.mark.nightly  # a task is held for stuck after ten seconds
async def test_hung_task_stops_the_watchdog_and_is_named_by_health(
    tmp_path: Path, manager: ServiceManager, blocked: Path
) -> None:
    with running_daemon(own_settings(tmp_path), tmp_path) as daemon:
        manager.until("WATCHDOG")
        daemon.process.send_signal(signal.SIGUSR2)
        stuck = manager.until("STATUS", "failed: ")[-1]
        assert "'reference watch'" in stuck["STATUS"]
        assert "WATCHDOG" not in stuck
        assert all("WATCHDOG" not in manager.next() for _ in range(3))
        ended = daemon.pcmrs("health", "--json")
        assert ended.returncode == 1
        health = json.loads(ended.stdout)
        assert health["status"] == "failed"
        assert "task_stuck" in [reason["code"] for reason in health["reasons"]]
        assert [task["name"] for task in health["tasks"] if not task["answers"]] == ["reference watch"]


@pytest.mark.nightly
def test_the_command_says_what_is_wrong_and_what_to_do(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = f"metrics.port={other.getsockname()[1]}"
        no_room = ("recording.enabled=true", "recording.keep_free_mb=1e12")
        with running_daemon([*own_settings(tmp_path), taken, *no_room], tmp_path) as daemon:
            assert daemon.ready.metrics == ""
            assert wait_until(lambda: "recording_ended" in daemon.pcmrs("health").stdout)
            ended = daemon.pcmrs("health")
            assert (ended.returncode, ended.stderr) == (1, "")
            assert "degraded: metrics_not_served" in ended.stdout
            assert "→ Give another metrics.port" in ended.stdout
            (node,) = daemon.children()
            os.kill(node, signal.SIGKILL)
            assert wait_until(lambda: restarts(daemon) == 1)
            assert "Traceback" not in daemon.log


def restarts(daemon: ServeProcess) -> int:
    (node,) = json.loads(daemon.pcmrs("health", "--json").stdout)["nodes"]
    many: int = node["restarts"]
    return many
