"""Metrics for Prometheus, on a loopback port: the facts of the daemon's health, read at every scrape."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from threading import Thread
from typing import Any

import structlog
from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from pcmrs.messages.health import Health
from pcmrs.service.health._scrape_server import ScrapeServer

log = structlog.get_logger(__name__)

HOST = "127.0.0.1"
"""Loopback only, since there is no access control."""
ANSWER_TIME = 1.0
"""Limit for the answer of the event loop, s; a late loop is reported instead of its facts."""
STATUSES = ("ok", "degraded", "failed")

Rows = list[tuple[list[str], float]]
"""Values of the labels, and the value of the metric."""


class HealthCollector(Collector):
    """Facts as metrics; if the daemon does not answer, only that.

    Args:
        ask: Returns the present facts, or None if the daemon does not answer in time. It is called in the thread of a
            scrape.
    """

    def __init__(self, ask: Callable[[], Health | None]) -> None:
        self._ask = ask

    def collect(self) -> Iterator[Metric]:
        """See `Collector.collect`."""
        health = self._ask()
        text = "Whether the daemon's event loop answered this scrape; without it there are no other metrics of pcmrs."
        yield GaugeMetricFamily("pcmrs_loop_answers", text, value=float(health is not None))
        if health is not None:
            yield from metrics_of(health)


class MetricsServer:
    """Server of metrics over HTTP in its own threads; see `ScrapeServer` for its limits.

    Args:
        port: Port on loopback; 0 takes a free one, None serves nothing.

    Attributes:
        trouble: Why metrics are not served although they are configured.
        address: Address of the metrics; empty while they are not served.
    """

    def __init__(self, port: int | None) -> None:
        self.trouble = self.address = ""
        self._port = port
        self._serving: tuple[ScrapeServer, Thread] | None = None

    def start(self, health: Callable[[], Health]) -> None:
        """Start to serve. If the port is taken, log that and store it in `trouble`: the cell works without metrics.

        Args:
            health: Returns the facts. It is called in the event loop that runs now.
        """
        if self._port is None:
            return
        loop = asyncio.get_running_loop()
        registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        registry.register(HealthCollector(lambda: ask(loop, health)))
        try:
            server = ScrapeServer(HOST, self._port, registry)
        except OSError as error:
            self.trouble = f"Port {self._port} of {HOST} cannot be bound for metrics: {error.strerror}."
            log.warning("metrics_not_served", reason=self.trouble)
        else:
            thread = Thread(target=server.serve_forever, name="pcmrs-metrics", daemon=True)
            thread.start()
            self._serving = server, thread
            self.address = f"http://{HOST}:{server.server_port}/metrics"

    async def close(self) -> None:
        """Stop serving."""
        if self._serving is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._close, *self._serving)

    @staticmethod
    def _close(server: ScrapeServer, thread: Thread) -> None:
        server.shutdown()
        server.server_close()
        thread.join()


def ask(loop: asyncio.AbstractEventLoop, health: Callable[[], Health]) -> Health | None:
    """Read the health from another thread; None if the loop does not answer within `ANSWER_TIME`.

    Args:
        loop: The event loop of the daemon.
        health: Returns the facts. It is called in the event loop.
    """
    answered: Future[Health] = Future()

    def answer() -> None:
        if not answered.set_running_or_notify_cancel():
            return  # the scrape has given up
        try:
            answered.set_result(health())
        except Exception as error:
            answered.set_exception(error)

    loop.call_soon_threadsafe(answer)
    try:
        return answered.result(ANSWER_TIME)
    except TimeoutError:
        answered.cancel()
        return None


def metrics_of(health: Health) -> Iterator[Metric]:
    """Yield the metrics of the facts, except `pcmrs_loop_answers`; their table is in docs/health.md."""
    yield _info(health)
    yield from _of_verdict(health)
    yield from _of_decisions(health)
    yield from _of_tasks(health)
    yield from _of_devices(health)
    yield from _of_queues(health)


def _info(health: Health) -> Metric:
    tag = health.blueprint
    labels = {**health.versions, "workflow": tag.id, "workflow_version": tag.version, "workflow_hash": tag.hash}
    return InfoMetricFamily("pcmrs", "Versions, and the workflow that is decided under.", value=labels)


def _of_verdict(health: Health) -> Iterator[Metric]:
    yield _gauge("uptime_seconds", "Since the daemon serves.", health.uptime)
    states: Rows = [([status], float(status == health.status)) for status in STATUSES]
    yield _gauges("health", "1 of the present verdict on the daemon's health, 0 of the others.", ["status"], states)
    found: Rows = [([severity, code], 1.0) for severity, code in sorted({(r.severity, r.code) for r in health.reasons})]
    yield _gauges("health_reason", "1 for each reason why the daemon is not well.", ["severity", "code"], found)
    yield _gauge("latched", "Whether Stop is latched.", health.latched)
    yield _gauge("fail_stop", "Whether nothing is accepted any more but Stop.", bool(health.fail_stop))


def _of_decisions(health: Health) -> Iterator[Metric]:
    decided: Rows = [([decision], many) for decision, many in health.decisions.items()]
    yield _counters("decisions", "Decisions on commands and events.", ["decision"], decided)
    rejected: Rows = [([code], many) for code, many in health.rejections.items()]
    yield _counters("rejections", "Rejected commands by reason.", ["code"], rejected)
    text = "From a command's arrival at an edge to its verdict; with the time of what it performs."
    latencies = HistogramMetricFamily("pcmrs_decision_latency_seconds", text, labels=["decision"])
    for each in health.latencies:
        buckets = [(str(bound), float(many)) for bound, many in each.buckets]
        latencies.add_metric([each.decision], [*buckets, ("+Inf", float(each.count))], each.sum)
    yield latencies


def _of_tasks(health: Health) -> Iterator[Metric]:
    answers: Rows = [([task.name], task.answers) for task in health.tasks]
    yield _gauges("task_answers", "Whether a task of the daemon works.", ["task"], answers)
    restarts: Rows = [([task.name], task.restarts) for task in health.tasks]
    yield _counters("task_restarts", "Tasks of the daemon that died and were restarted.", ["task"], restarts)
    yield _counter("stray_failures", "Failures in the event loop that belong to no task.", health.strays)
    yield _gauge("loop_lag_seconds", "How late the event loop answered last.", health.loop.lag)
    yield _counter("loop_stalls", "Stalls of the event loop.", health.loop.stalls)
    yield _gauge("loop_longest_stall_seconds", "The longest stall since the start.", health.loop.longest)


def _of_devices(health: Health) -> Iterator[Metric]:
    restarts: Rows = [([node.driver], node.restarts) for node in health.nodes]
    yield _counters("node_restarts", "Device nodes that ended by themselves and were restarted.", ["driver"], restarts)
    lost: Rows = [([node.driver], node.given_up) for node in health.nodes]
    yield _gauges("node_given_up", "Whether a device node is not restarted any more.", ["driver"], lost)
    connected: Rows = [([each.device], each.connected) for each in health.devices]
    yield _gauges("device_connected", "Whether a device is there, as its node said last.", ["device"], connected)
    heard: Rows = [([each.device], each.heard) for each in health.devices if each.heard is not None]
    yield _gauges("device_heartbeat_age_seconds", "Time since the last heartbeat of its node.", ["device"], heard)
    data: Rows = [([each.device], each.data) for each in health.devices if each.data is not None]
    yield _gauges("device_data_age_seconds", "Since joints or poses came.", ["device"], data)
    late: Rows = [([each.device, kind], many) for each in health.devices for kind, many in each.dropped.items()]
    text = "Messages that came too late at a device's node to be followed."
    yield _counters("device_dropped", text, ["device", "kind"], late)


def _of_queues(health: Health) -> Iterator[Metric]:
    depths: Rows = [([each.queue], each.depth) for each in health.queues]
    yield _gauges("queue_depth", "What waits in a queue.", ["queue"], depths)
    limits: Rows = [([each.queue], each.limit) for each in health.queues]
    yield _gauges("queue_limit", "How much may wait there.", ["queue"], limits)
    refused: Rows = [([each.queue], each.refused) for each in health.queues if each.refused is not None]
    yield _counters("queue_refused", "What did not fit into a queue.", ["queue"], refused)
    dropped: Rows = [([what], many) for what, many in health.dropped.items()]
    yield _counters("dropped", "What was dropped, refused or replaced elsewhere.", ["what"], dropped)
    yield _counter("datagrams", "Datagrams and TCP frames that arrived at the gateway.", health.datagrams)
    yield _gauge("journal_failed", "Whether the journal cannot be written.", bool(health.journal.failure))
    text = "How long the row that waits longest has waited for the disk."
    yield _gauge("journal_oldest_wait_seconds", text, health.journal.oldest_wait)
    if health.journal.free is not None:
        yield _gauge("journal_disk_free_bytes", "Free space on the disk of the journal.", health.journal.free)


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"pcmrs_{name}", text, value=float(value))


def _counter(name: str, text: str, value: float) -> Metric:
    return CounterMetricFamily(f"pcmrs_{name}", text, value=float(value))


def _gauges(name: str, text: str, labels: list[str], rows: Rows) -> Metric:
    return _filled(GaugeMetricFamily(f"pcmrs_{name}", text, labels=labels), rows)


def _counters(name: str, text: str, labels: list[str], rows: Rows) -> Metric:
    return _filled(CounterMetricFamily(f"pcmrs_{name}", text, labels=labels), rows)


def _filled(family: Any, rows: Rows) -> Metric:
    for labels, value in rows:
        family.add_metric(labels, float(value))
    filled: Metric = family
    return filled
