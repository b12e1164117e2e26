"""Metrics: the same numbers as the health, a table in the documentation that is true, and a loop that is blocked."""

from __future__ import annotations

import asyncio
import re
import socket
import threading
import urllib.request
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from prometheus_client.metrics_core import Metric
from prometheus_client.parser import text_string_to_metric_families
from structlog.testing import capture_logs

from pcmrs.messages.health import Health, HealthReason
from pcmrs.service.health.metrics import HOST, HealthCollector, MetricsServer, ask
from pcmrs.service.health.report import report
from tests import ROOT
from tests.support.health_facts import WELL

DOCS = ROOT / "docs" / "health.md"


REASON = HealthReason(severity="degraded", code="loop_late", text="Late.", remedy="Wait.")


def health() -> Health:
    return report(WELL)


@asynccontextmanager
async def serving(server: MetricsServer) -> AsyncIterator[str]:
    server.start(health)
    try:
        yield server.address
    finally:
        await server.close()


def scrape(address: str) -> str:
    with urllib.request.urlopen(address, timeout=60) as answer:
        text: str = answer.read().decode()
    return text


def samples(text: str) -> dict[tuple[str, tuple[str, ...]], float]:
    return {
        (sample.name, tuple(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_a_scrape_has_the_numbers_of_the_health() -> None:
    async with serving(MetricsServer(0)) as address:
        found = samples(await asyncio.to_thread(scrape, address))
    expected = {
        ("pcmrs_loop_answers", ()): 1,
        ("pcmrs_uptime_seconds", ()): 3725,
        ("pcmrs_health", ("ok",)): 1,
        ("pcmrs_health", ("failed",)): 0,
        ("pcmrs_decisions_total", ("rejected",)): 10,
        ("pcmrs_rejections_total", ("busy",)): 10,
        ("pcmrs_decision_latency_seconds_bucket", ("accepted", "0.25")): 2,
        ("pcmrs_decision_latency_seconds_bucket", ("accepted", "+Inf")): 3,
        ("pcmrs_decision_latency_seconds_sum", ("accepted",)): 0.6,
        ("pcmrs_task_restarts_total", ("reference watch",)): 2,
        ("pcmrs_device_heartbeat_age_seconds", ("robot",)): 0.02,
        ("pcmrs_device_dropped_total", ("robot", "beats")): 3,
        ("pcmrs_queue_depth", ("bus",)): 2,
        ("pcmrs_queue_refused_total", ("bus",)): 5,
        ("pcmrs_dropped_total", ("bus.replaced",)): 8,
        ("pcmrs_loop_stalls_total", ()): 4,
        ("pcmrs_journal_oldest_wait_seconds", ()): 0.002,
    }
    assert {key: found[key] for key in expected} == expected
    assert ("pcmrs_device_heartbeat_age_seconds", ("emg",)) not in found
    assert found["process_open_fds", ()] > 0


def _row(metric: Metric) -> tuple[str, str, tuple[str, ...]]:
    """Name, type and labels as the table has them."""
    ending = {"counter": "_total", "info": "_info"}.get(metric.type, "")
    kind = "gauge" if metric.type == "info" else metric.type
    labels = {name for sample in metric.samples for name in sample.labels if name != "le"}
    return metric.name + ending, kind, tuple(sorted(labels))


def test_the_table_in_the_documentation_is_the_one_of_the_code() -> None:
    ill = report(WELL)
    told = Health(**{name: getattr(ill, name) for name in ill.__struct_fields__} | {"reasons": [REASON]})
    made = {_row(metric) for metric in HealthCollector(lambda: told).collect()}
    rows = re.findall(r"^\| `(pcmrs_\w+)` \| (\w+) \|([^|]*)\|", DOCS.read_text(), re.MULTILINE)
    written = {(name, kind, tuple(sorted(re.findall(r"`(\w+)`", labels)))) for name, kind, labels in rows}
    assert written == made
    assert len(rows) == len(made)


async def test_blocked_loop_is_reported_in_place_of_its_facts() -> None:
    told: list[dict[tuple[str, tuple[str, ...]], float]] = []
    async with serving(MetricsServer(0)) as address:
        thread = threading.Thread(target=lambda: told.append(samples(scrape(address))))
        thread.start()
        thread.join()  # in the loop's own thread: the loop is blocked until the scrape has its answer
        assert samples(await asyncio.to_thread(scrape, address))["pcmrs_loop_answers", ()] == 1
    (blocked,) = told
    assert blocked["pcmrs_loop_answers", ()] == 0
    assert [name for name, _ in blocked if name.startswith("pcmrs_")] == ["pcmrs_loop_answers"]


async def test_facts_are_read_in_the_loop_and_not_for_absent_askers() -> None:
    loop, readers = asyncio.get_running_loop(), list[int]()

    def read() -> Health:
        readers.append(threading.get_ident())
        return health()

    assert await asyncio.to_thread(ask, loop, read) is not None
    thread = threading.Thread(target=ask, args=(loop, read))
    thread.start()
    thread.join()
    await asyncio.sleep(0)
    assert readers == [threading.get_ident()]


async def test_port_in_use_is_logged_and_does_not_end_the_daemon() -> None:
    with socket.socket() as other:
        other.bind((HOST, 0))
        other.listen()
        port = other.getsockname()[1]
        server = MetricsServer(port)
        with capture_logs() as told:
            async with serving(server) as address:
                assert address == ""
    assert str(port) in server.trouble
    assert [each["event"] for each in told] == ["metrics_not_served"]


async def test_without_a_port_nothing_is_served() -> None:
    server = MetricsServer(None)
    async with serving(server) as address:
        assert (address, server.trouble) == ("", "")
