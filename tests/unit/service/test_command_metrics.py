"""Counting decisions, reasons and the time until a verdict."""

from __future__ import annotations

from pcmrs.messages import Command, DeviceEvent, Reason, Verdict
from pcmrs.messages._decisions import Decision
from pcmrs.service._command_metrics import BOUNDS, RECENT, CommandMetrics
from pcmrs.testing.clock import ManualClock


def verdict(decision: Decision, code: str = "") -> Verdict:
    reason = Reason(code=code, text="So.") if code else None
    return Verdict(id="c", branch="b", operation="o", decision=decision, state="0", sequence=1, reason=reason)


class Bench:
    """A dispatcher that takes its time."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.tally = CommandMetrics(self._decide, self.clock)
        self._takes, self._decision = 0.0, verdict("accepted")

    async def submit(self, takes: float, decision: Decision = "accepted") -> Verdict:
        self._takes, self._decision = takes, verdict(decision)
        return await self.tally.submit(Command(id="c", branch="b", operation="o", source="test"))

    async def _decide(self, _command: Command, *, arrived: float | None = None) -> Verdict:
        self.clock.stall(self._takes)
        return self._decision


async def test_latency_is_reported_for_each_decision() -> None:
    bench = Bench()
    for number in range(1, 101):
        assert (await bench.submit(number / 100)).decision == "accepted"
    await bench.submit(0.002, "rejected")
    accepted, rejected = bench.tally.latencies()
    assert (accepted.decision, accepted.count, rejected.decision, rejected.count) == ("accepted", 100, "rejected", 1)
    assert abs(accepted.sum - 50.5) < 1e-9
    assert abs(accepted.p50 - 0.5) < 1e-9
    assert abs(accepted.p99 - 0.99) < 1e-9
    assert abs(rejected.p50 - rejected.p99) < 1e-12


async def test_buckets_are_cumulative_and_longer_times_are_counted() -> None:
    bench = Bench()
    for takes in (0.0, 0.3, BOUNDS[-1] + 1.0):
        await bench.submit(takes)
    (told,) = bench.tally.latencies()
    buckets = dict(told.buckets)
    assert tuple(buckets) == BOUNDS
    assert (buckets[BOUNDS[0]], buckets[0.25], buckets[0.5], buckets[BOUNDS[-1]]) == (1, 1, 2, 2)
    assert told.count == 3


async def test_percentiles_are_of_the_last_commands() -> None:
    bench = Bench()
    await bench.submit(50.0)
    for _ in range(RECENT):
        await bench.submit(0.25)
    (told,) = bench.tally.latencies()
    assert abs(told.p99 - 0.25) < 1e-9
    assert told.count == RECENT + 1


def test_decisions_are_counted_and_reasons_of_rejections_only() -> None:
    tally = Bench().tally
    decided: tuple[tuple[Decision, str], ...] = (("accepted", ""), ("rejected", "busy"), ("rejected", "busy"))
    for decision, code in (*decided, ("failed", "device_failed")):
        tally.take(verdict(decision, code))
    tally.take(DeviceEvent(device="r", code="busy", text="So."))
    assert dict(tally.decisions) == {"accepted": 1, "rejected": 2, "failed": 1, "unknown": 0}
    assert dict(tally.rejections) == {"busy": 2}
