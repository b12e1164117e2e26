"""From a completed command to its verdict; the journal takes a limited number of each user's rejections."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from pcmrs.dispatcher import Dispatcher, DispatcherListener, decisions
from pcmrs.dispatcher.decisions import DROPPED, RATE_HZ, TOGETHER, TOO_MANY, Rejections
from pcmrs.messages import Command, DeviceEvent, Verdict
from pcmrs.messages.clipping import CLIPPED, LONGEST_FIELDS, LONGEST_TEXT
from pcmrs.testing.clock import ManualClock, settle
from tests.unit.dispatcher.dispatcher_fakes import Bench, make_workflow

BURST = 5


class Limited(Bench):
    """A bench whose journal takes `BURST` rejections at once."""

    def __init__(self) -> None:
        super().__init__()
        self.machine = ManualClock()
        self.dispatcher: Dispatcher[Any, Any] = Dispatcher(
            make_workflow(self.script),
            None,
            self.clock,
            self.recorder,
            self._hold_devices,
            release=self._release_devices,
            rejections=Rejections(self.machine),
        )
        self.dispatcher.add_listener(self)

    async def codes(self, count: int, **fields: Any) -> list[str]:
        verdicts = [await self.do("registration.no_such_operation", **fields) for _ in range(count)]
        assert {verdict.decision for verdict in verdicts} == {"rejected"}
        return [verdict.reason.code for verdict in verdicts if verdict.reason is not None]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Limited:
    monkeypatch.setattr(decisions, "BURST", BURST)
    return Limited()


async def test_rejection_beyond_the_limit_leaves_no_row(bench: Limited) -> None:
    assert await bench.codes(BURST + 3, user="eve") == ["unknown_operation"] * BURST + [TOO_MANY] * 3
    assert len(bench.recorder.rows) == BURST
    refused = await bench.do("registration.no_such_operation", user="eve")
    assert refused.reason is not None
    assert refused.reason.fields == {
        "rejected_for": "unknown_operation",
        "limit_hz": RATE_HZ,
        "retry_after": pytest.approx(1.0 / RATE_HZ),
    }


async def test_a_rejection_without_a_row_is_not_published(bench: Limited) -> None:
    """Everybody would be told of it, as often as somebody asks in vain."""
    await bench.codes(BURST + 3, user="eve")
    await settle()
    shown = [each.reason.code for each in bench.published if isinstance(each, Verdict) and each.reason is not None]
    assert shown == ["unknown_operation"] * BURST


async def test_accepted_commands_and_those_of_others_are_not_limited(bench: Limited) -> None:
    await bench.codes(BURST + 1, user="eve")
    assert (await bench.do("registration.plan_landmarks", user="eve")).decision == "accepted"
    assert await bench.codes(1, user="anna") == ["unknown_operation"]
    assert await bench.codes(1, user="eve") == [TOO_MANY]


async def test_one_row_says_how_many_rejections_have_none(bench: Limited) -> None:
    await bench.codes(BURST + 4, user="eve")
    await bench.dispatcher.close()
    await settle()
    (told,) = [each for each in bench.published if isinstance(each, DeviceEvent) and each.code == DROPPED]
    assert told.fields == {"user": "eve", "count": 4, "limit_hz": RATE_HZ}
    assert [name for _, name, _, _ in bench.recorder.rows].count(DROPPED) == 1


async def test_limited_command_is_decided_again_when_it_is_repeated(bench: Limited) -> None:
    await bench.codes(BURST, user="eve")
    assert await bench.codes(1, user="eve", id="again") == [TOO_MANY]
    await bench.machine.advance(2.0 / RATE_HZ)
    assert await bench.codes(1, user="eve", id="again") == ["unknown_operation"]


async def test_a_dispatcher_tells_of_accepted_commands_only(bench: Limited) -> None:
    accepted: list[str] = []

    class Listener(DispatcherListener):
        def on_accepted(self, command: Command) -> None:
            accepted.append(command.operation)

    bench.dispatcher.add_listener(Listener())
    await bench.do("placement.approach")
    await bench.do("registration.no_such_operation")
    assert accepted == []
    await bench.do("registration.plan_landmarks")
    assert accepted == ["plan_landmarks"]
    await bench.dispatcher.close()


async def test_names_that_a_sender_has_chosen_fill_no_row(bench: Limited) -> None:
    """The row, the answer, the published verdict and the verdict in memory are the same object."""
    verdict = await bench.do("toolplan.plan", user="eve", arguments={"x" * 60_000: 1, "y" * 60_000: 1})
    assert verdict.reason is not None
    assert verdict.reason.code == "bad_arguments"
    assert len(verdict.reason.text) < LONGEST_TEXT + 50
    assert set(verdict.reason.fields) == {CLIPPED}
    assert len(msgspec.json.encode(verdict)) < 2 * LONGEST_FIELDS + LONGEST_TEXT
    await settle()
    assert bench.recorder.rows[-1][-1] == verdict
    assert bench.published[-1] == verdict


async def test_many_names_share_a_limit(bench: Limited) -> None:
    """A program on the cell's machine may use any name."""
    codes = [code for number in range(TOGETHER + 2) for code in await bench.codes(BURST, user=f"eve{number}")]
    assert codes == ["unknown_operation"] * TOGETHER * BURST + [TOO_MANY] * 2 * BURST
    assert len(bench.recorder.rows) == TOGETHER * BURST
    refused = await bench.do("registration.no_such_operation", user="anna")
    assert refused.reason is not None
    assert refused.reason.fields["limit_hz"] == TOGETHER * RATE_HZ
    assert "all users" in refused.reason.text


async def test_of_many_reused_ids_a_limited_number_is_shown(bench: Limited) -> None:
    """Everybody receives a verdict that is published."""
    await bench.do("registration.plan_landmarks", user="eve", id="9")
    await settle()
    before = len(bench.published)
    verdicts = [await bench.do("toolplan.clear", user="eve", id="9") for _ in range(BURST + 3)]
    codes = [verdict.reason.code for verdict in verdicts if verdict.reason is not None]
    assert codes == ["id_reused"] * BURST + [TOO_MANY] * 3
    await settle()
    assert bench.published[before:] == verdicts[:BURST]
    await bench.dispatcher.close()
