"""Health of the daemon: latencies, ages and losses, as it reports them; missing values read "not known"."""

from __future__ import annotations

from nicegui import ui

from pcmrs.console.texts import Texts
from pcmrs.messages.health import Health

Row = tuple[str, str]


class HealthPanel:
    """Verdict, its reasons, and a table.

    Args:
        texts: Texts in the language of the page.
    """

    def __init__(self, texts: Texts) -> None:
        self._texts = texts
        self._status = ui.label().classes("text-weight-bold").props('data-testid="health"')
        self._reasons = ui.column().classes("w-full gap-0")
        columns = [
            {"name": name, "label": texts(name), "field": name, "align": "left", "style": "white-space: normal"}
            for name in ("what", "value")
        ]
        self._table = ui.table(columns=columns, rows=[], row_key="what").classes("w-full").props("dense flat")
        self._table.props('data-testid="counters"')

    def draw(self, health: Health | None) -> None:
        """Show the last reported health; None while the daemon does not answer, or in a recording without it."""
        texts = self._texts
        status = texts("unknown") if health is None else health.status
        self._status.set_text(f"{texts('daemon')}: {status}")
        self._reasons.clear()
        if health is not None:
            with self._reasons:
                for reason in health.reasons:
                    ui.label(f"{reason.text} {reason.remedy}").classes("text-orange-9")
        rows = [] if health is None else [*_latencies(health, texts), *_devices(health, texts), *_counters(health)]
        self._table.rows = [{"what": what, "value": value} for what, value in rows]


def _latencies(health: Health, texts: Texts) -> list[Row]:
    loop = texts("ms", ms=1000.0 * health.loop.lag)
    return [
        (texts("loop"), loop),
        *(
            (
                texts("decided", decision=each.decision, count=each.count),
                texts("percentiles", p50=1000.0 * each.p50, p99=1000.0 * each.p99),
            )
            for each in health.latencies
        ),
    ]


def _devices(health: Health, texts: Texts) -> list[Row]:
    found = []
    for each in health.devices:
        heard, data = (
            texts("unknown") if age is None else texts("ms", ms=1000.0 * age) for age in (each.heard, each.data)
        )
        dropped = ", ".join(f"{kind} {many}" for kind, many in each.dropped.items()) or "0"
        found.append((each.device, texts("device_ages", heard=heard, data=data, dropped=dropped)))
    return found


def _counters(health: Health) -> list[Row]:
    queues = [(each.queue, f"{each.depth}/{each.limit}") for each in health.queues]
    return [*queues, *((name, str(many)) for name, many in health.dropped.items())]
