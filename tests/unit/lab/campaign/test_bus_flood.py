"""A flood of the bus sends what its kind says, as many as are wanted, and counts how they were answered."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict
from typing import Any

import pytest

from pcmrs.bus.codec import pack
from pcmrs.bus.settings import BusSettings
from pcmrs.bus.stop import Stopping
from pcmrs.errors import BusError, DeviceError, UnknownOutcomeError
from pcmrs_lab.campaign import bus_flood as flooding
from pcmrs_lab.campaign.attacks import attacks
from pcmrs_lab.campaign.bus_flood import KINDS, FloodReport, Kind, bus_flood
from pcmrs_lab.campaign.sham import sham
from pcmrs_lab.campaign.tries import recorded_tries
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started
from tests.unit.lab.scripted_client import verdict

PREFIX = "pcmrs/lab/cell1"
DONE = FloodReport(sent=7, seconds=2.0, answered=5, codes={"busy": 5})
LINE = json.dumps(asdict(DONE)).encode() + b"\n"


class ScriptedSession:
    def __init__(self) -> None:
        self.put_to: Counter[str] = Counter()
        self.closed = False

    def put(self, key: str, payload: bytes, **_: Any) -> None:
        self.put_to[key] += 1

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def session(monkeypatch: pytest.MonkeyPatch) -> ScriptedSession:
    made = ScriptedSession()
    monkeypatch.setattr(flooding, "open_session", lambda settings: made)
    return made


def answering(monkeypatch: pytest.MonkeyPatch, *answers: bytes | Exception) -> list[tuple[str, bytes]]:
    """Gives these answers in turn, and returns the queries."""
    asked: list[tuple[str, bytes]] = []

    async def query(_session: Any, _pool: Any, key: str, payload: bytes, *_: Any) -> bytes:
        asked.append((key, payload))
        answer = answers[(len(asked) - 1) % len(answers)]
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(flooding, "send_query", query)
    return asked


async def flood(kind: Kind, most: int) -> FloodReport:
    return await flooding._Flood(kind, BusSettings(cell="cell1"), "eve", most).run()


async def test_as_many_messages_are_put_as_are_wanted(session: ScriptedSession) -> None:
    report = await flood("puts", 1234)
    assert session.put_to == {f"{PREFIX}/cmd/eve/toolplan/plan": 1234}
    assert (report.sent, report.answered, session.closed) == (1234, 0, True)


async def test_stops_are_put_under_one_name_or_many(session: ScriptedSession) -> None:
    await flood("stop-puts", 50)
    assert session.put_to == {f"{PREFIX}/stop/eve": 50}
    session.put_to.clear()
    await flood("stop-names", flooding.STOP_NAMES + 1)
    assert len(session.put_to) == flooding.STOP_NAMES
    assert session.put_to[f"{PREFIX}/stop/eve0"] == 2


@pytest.mark.usefixtures("session")
async def test_answers_are_counted_by_their_result(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = (
        pack(verdict()),
        pack(verdict(decision="rejected", code="malformed")),
        BusError("Too many.", reason="busy"),
        UnknownOutcomeError("Nobody answers."),
        b"no verdict",
    )
    asked = answering(monkeypatch, *answers)
    report = await flood("rejected", 200)
    assert (report.sent, len(asked)) == (200, 200)
    assert report.codes == dict.fromkeys(("accepted", "malformed", "busy", UnknownOutcomeError.code, "answered"), 40)
    assert report.answered == 160, "a request without an answer is not answered"


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize(
    ("kind", "key"),
    [
        ("setup", "svc/setup/eve"),
        ("journal", "svc/journal"),
        ("check", "svc/check/eve"),
        ("stop-queries", "stop/eve"),
    ],
)
async def test_a_kind_asks_at_its_key(monkeypatch: pytest.MonkeyPatch, kind: Kind, key: str) -> None:
    asked = answering(monkeypatch, pack(Stopping(source="bus:eve", number=1)))
    report = await flood(kind, 3)
    assert {each for each, _ in asked} == {f"{PREFIX}/{key}"}
    assert report.codes == {"accepted": 3}


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize("kind", ["rejected", "rejected-names", "rejected-keys"])
async def test_a_rejected_command_is_large(monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    asked = answering(monkeypatch, b"")
    await flood(kind, 1)
    ((key, payload),) = asked
    assert key.startswith(f"{PREFIX}/cmd/eve/toolplan/")
    assert len(key + payload.decode(errors="replace")) > flooding.ARGUMENT_SIZE


def test_a_rate_is_of_what_was_sent_in_the_time_taken() -> None:
    assert FloodReport(sent=100, seconds=4.0).rate == 25.0
    assert FloodReport(sent=100).rate == 0.0


@pytest.mark.parametrize("kind", KINDS)
async def test_the_report_is_complete_when_the_flood_ends(monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    child = ScriptedChild(b"begun\n", LINE)
    started(monkeypatch, child)
    async with bus_flood(kind, "tcp/127.0.0.1:1", "cell1") as running:
        assert running.report == FloodReport()
    assert running.report == DONE
    where = ("--endpoint", "tcp/127.0.0.1:1", "--cell", "cell1")
    assert child.words[3:] == (kind, *where, "--user", "eve", "--most", "0")
    assert child.returncode == 0


async def test_a_flood_of_a_number_has_ended_before_the_context(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b"begun\n" + LINE))
    async with bus_flood("puts", "tcp/127.0.0.1:1", "cell1", most=7) as running:
        assert running.report.sent == 7


async def test_a_flood_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b""))
    with pytest.raises(DeviceError, match="flood of setup did not start"):
        async with bus_flood("setup", "tcp/127.0.0.1:1", "cell1"):
            pass


async def test_a_sham_flood_sends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch)
    with sham():
        async with bus_flood("puts", "tcp/127.0.0.1:1", "cell1", most=7) as running:
            pass
    assert running.report.sent == 0


@pytest.mark.parametrize(
    ("kind", "keys"),
    [
        ("setpoints", {"teleop/eve"}),
        ("devices", {"dev/robot/event", "dev/robot/beat"}),
        ("streams", {"state/joints", "state/pose/coil"}),
    ],
)
async def test_a_kind_of_puts_goes_to_its_keys(session: ScriptedSession, kind: Kind, keys: set[str]) -> None:
    await flood(kind, 6)
    assert set(session.put_to) == {f"{PREFIX}/{key}" for key in keys}


@pytest.mark.parametrize("kind", KINDS)
async def test_a_flood_is_recorded_as_tried(monkeypatch: pytest.MonkeyPatch, kind: Kind) -> None:
    started(monkeypatch, ScriptedChild(b"begun\n", LINE))
    with recorded_tries() as tried:
        async with bus_flood(kind, "tcp/127.0.0.1:1", "cell1"):
            pass
    ((way, by),) = tried
    assert (way in attacks().ways, by) == (True, "flood")
