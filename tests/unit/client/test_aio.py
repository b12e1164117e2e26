"""The asyncio client against a small daemon on a real bus."""

import asyncio
import subprocess
import sys
import threading
from contextlib import aclosing
from typing import Any, cast

import msgspec
import pytest
import zenoh

from pcmrs.bus import Bus, BusSettings, Empty, _session
from pcmrs.bus.commands import Envelope
from pcmrs.bus.serving import payload_of
from pcmrs.client import Client, Event, _aio
from pcmrs.errors import BusError, DeviceError, PayloadError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, DeviceReply, DeviceRequest, Reason, Snapshot, StopState, Verdict
from tests.unit.bus.bus_cells import TIMEOUT, new_cell, open_bus, plain_session, snapshot
from tests.unit.client.small_daemon import connected

FLOOD = 2_000
"""Number of messages that is more than enough to fill the queue of a subscription."""


async def test_a_call_is_a_command_with_id_and_time_to_live() -> None:
    async with connected() as (daemon, client):
        verdict = await client.call("digitization.digitize_one", {"index": 2})
        assert verdict.decision == "accepted"
        (command,) = daemon.commands
        assert (command.source, command.branch, command.operation) == ("bus:anna", "digitization", "digitize_one")
        assert (command.id, command.arguments) == (verdict.id, {"index": 2})
        assert command.sent is not None
        assert command.ttl is not None


async def test_an_id_of_the_caller_is_kept() -> None:
    async with connected() as (_, client):
        assert (await client.call("robot.connect", id="again")).id == "again"


@pytest.mark.parametrize("name", ["reinit", "registration.", "Registration.reinit", "registration.re/init", "a.*"])
async def test_a_name_that_is_no_operation_is_refused_here(name: str) -> None:
    async with connected() as (daemon, client):
        with pytest.raises(PayloadError):
            await client.call(name)
        assert daemon.commands == []


async def test_state_is_the_present_snapshot() -> None:
    async with connected() as (_, client):
        await client.call("robot.connect")
        assert (await client.state()).sequence == 1


async def test_next_step_is_asked_of_the_daemon() -> None:
    async with connected() as (_, client):
        assert (await client.next_step("robot.connect")).path == ["robot.connect"]
        assert (await client.next_step()).next == ""


async def test_daemon_confirms_stop_and_device_nodes_receive_it() -> None:
    async with connected() as (daemon, client):
        heard = asyncio.Event()
        settings = msgspec.structs.replace(daemon.bus.settings, mode="client")
        async with open_bus(settings) as node:
            node.subscribe("stop/*", Empty, lambda _, __: heard.set())
            await node.request("svc/snapshot", Empty(), Snapshot, TIMEOUT)
            await client.stop()
            assert "bus:anna" in daemon.stops
            await asyncio.wait_for(heard.wait(), TIMEOUT)


async def test_one_press_is_one_stop_whichever_message_comes_first() -> None:
    """It is put and asked for: the second message must not stop again what has been acknowledged meanwhile."""
    async with connected() as (daemon, client):
        assert [(await client.stop()).number for _ in range(3)] == [1, 2, 3]
        await client.state()
        assert daemon.stops == ["bus:anna"] * 3


async def test_stop_is_answered_while_a_stream_is_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zenoh holds back everything of a session while the queue of one of its subscriptions is full."""
    receiving, stopped = threading.Event(), threading.Event()

    def receive(sample: zenoh.Sample) -> bytes:
        if str(sample.key_expr).endswith("/state/joints"):
            receiving.set()
            stopped.wait(TIMEOUT)
        return payload_of(sample)

    monkeypatch.setattr(_session, "payload_of", receive)
    async with connected() as (daemon, client):
        client.listen("state/joints", dict, lambda _: None)
        await client.state()  # the router knows the subscription by now
        for _ in range(FLOOD):
            daemon.bus.publish("state/joints", {})
        assert await asyncio.to_thread(receiving.wait, TIMEOUT)
        try:
            assert (await client.stop()).number == 1
        finally:
            stopped.set()


async def test_watch_yields_the_last_snapshot_then_what_happens() -> None:
    async with connected() as (daemon, client):
        daemon.bus.publish("state/fsm", snapshot(41))
        events = client.watch()

        async def next_event() -> Event:
            return await asyncio.wait_for(anext(events), TIMEOUT)

        assert await next_event() == snapshot(41)
        verdict = await client.call("robot.connect")
        assert await next_event() == verdict
        fault = DeviceEvent(device="robot", code="link_lost", text="The link is cut.", danger=True)
        daemon.bus.publish("state/event", fault)
        assert await next_event() == fault
        await events.aclose()


async def test_a_watcher_ignores_what_is_no_event() -> None:
    """An error in a handler is logged with its traceback, for each message; what is ignored is logged once a second."""
    errors: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: errors.append(context))
    async with connected() as (daemon, client), aclosing(client.watch()) as events:
        daemon.bus.publish("state/fsm", snapshot(0))
        assert await anext(events) == snapshot(0)
        await client.state()  # the router knows the subscriptions by now
        daemon.bus.publish("state/event", {"no": "event"})
        fault = DeviceEvent(device="robot", code="link_lost", text="The link is cut.", danger=True)
        daemon.bus.publish("state/event", fault)
        assert await asyncio.wait_for(anext(events), TIMEOUT) == fault
    assert errors == []


async def test_slow_watcher_gets_the_newest_and_the_number_missed() -> None:
    def event(number: int) -> DeviceEvent:
        return DeviceEvent(device="robot", code="told", text=str(number))

    async with connected() as (daemon, client):
        async with aclosing(client.watch()) as events:
            daemon.bus.publish("state/fsm", snapshot(0))
            assert await anext(events) == snapshot(0)
            heard = asyncio.Queue[str]()
            client.listen("state/event", DeviceEvent, lambda told: heard.put_nowait(told.text))
            await client.state()
            for number in range(1, 1101):
                daemon.bus.publish("state/event", event(number))
                assert await asyncio.wait_for(heard.get(), TIMEOUT) == str(number)
            async with asyncio.timeout(TIMEOUT):
                while client.missed < 1100 - 1024:  # noqa: ASYNC110 (two subscribers are told one after the other)
                    await asyncio.sleep(0.001)
            assert await asyncio.wait_for(anext(events), TIMEOUT) == event(1100 - 1024 + 1)
        assert client.missed == 1100 - 1024


async def test_a_closed_watch_is_no_subscriber_any_more() -> None:
    async with connected() as (daemon, client):
        with plain_session(daemon.bus.settings) as session:
            loop, changes = asyncio.get_running_loop(), asyncio.Queue[tuple[str, bool]]()

            def listen(key: str) -> zenoh.Publisher:
                def note(status: zenoh.MatchingStatus) -> None:
                    loop.call_soon_threadsafe(changes.put_nowait, (key, status.matching))

                publisher = session.declare_publisher(f"{daemon.bus.prefix}/{key}")
                publisher.declare_matching_listener(note)
                return publisher

            async def next_changes() -> set[tuple[str, bool]]:
                return {await asyncio.wait_for(changes.get(), TIMEOUT) for _ in publishers}

            publishers = [listen("state/fsm"), listen("state/event")]
            daemon.bus.publish("state/fsm", snapshot(1))
            async with aclosing(client.watch()) as events:
                await anext(events)
                assert await next_changes() == {("state/fsm", True), ("state/event", True)}
            assert await next_changes() == {("state/fsm", False), ("state/event", False)}


async def test_a_device_answers_past_the_daemon() -> None:
    async def handle(_: str, request: DeviceRequest) -> DeviceReply:
        if request.method == "reseed":
            return DeviceReply(result=request.arguments["seed"])
        return DeviceReply(failure=Reason(code="no_such_method", text="No such method.", fields={"n": 1}))

    async with connected() as (daemon, client):
        daemon.bus.serve("dev/scene/cmd", DeviceRequest, handle)
        assert await client.request_device("scene", "reseed", {"seed": 5}) == 5
        with pytest.raises(DeviceError) as error:
            await client.request_device("scene", "fly")
        assert error.value.fields == {"reason": "no_such_method", "values": {"n": 1}}


async def test_without_a_daemon_connecting_fails() -> None:
    with pytest.raises(BusError, match="start pcmrs-serve"):
        async with Client.connect(new_cell().endpoint):
            pytest.fail("connected to nothing")


async def test_another_cell_is_no_daemon_of_ours() -> None:
    async with connected() as (daemon, _):
        with pytest.raises(BusError, match="pcmrs/lab/elsewhere"):
            async with Client.connect(daemon.bus.settings.endpoint, cell="elsewhere"):
                pytest.fail("connected to another cell")


def test_importing_the_client_loads_no_numerics() -> None:
    heavy = ["numpy", "scipy", "pinocchio", "mujoco", "structlog", "uvloop", "sqlite3"]
    code = f"import sys, pcmrs.client; print([m for m in {heavy} if m in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


async def test_wait_for_a_state_that_does_not_come_times_out() -> None:
    async with connected() as (daemon, client):
        daemon.bus.publish("state/fsm", snapshot(1))
        assert await client.until(lambda shown: shown.sequence == 1, TIMEOUT) == snapshot(1)
        with pytest.raises(TimeoutError):
            await client.until(lambda shown: shown.sequence == 2, timeout=0.1)


async def test_an_acknowledgement_names_the_stop_that_was_seen() -> None:
    async with connected() as (daemon, client):
        daemon.shown = {"release": ["robot.acknowledge"], "stop": StopState(number=8)}
        await client.acknowledge(stop=7)
        (command,) = daemon.commands
        assert command.arguments == {"stop": 7}, "not Stop 8, which is newer and was not shown"


async def test_only_the_local_user_may_leave_a_stop_unnamed() -> None:
    shown = {"release": ["robot.acknowledge"], "stop": StopState(number=8)}
    async with connected() as (daemon, client):
        daemon.shown = shown
        with pytest.raises(RefusalError, match="acknowledge with stop = the number") as caught:
            await client.acknowledge()
        assert caught.value.refusal_code == "stop_not_named"
        assert daemon.commands == []
    async with connected("local") as (daemon, client):
        daemon.shown = shown
        await client.acknowledge()
        (command,) = daemon.commands
        assert command.arguments == {}, "the daemon decides, which refuses it while the Stop is young"


class FarBus:
    """A bus over a network, with an error for the setup and one answer for each time that a command is sent."""

    settings = BusSettings(endpoint="tls/far.example:7447")

    def __init__(self, setup: PcmrsError, *answers: PcmrsError | Verdict) -> None:
        self.setup, self.answers = setup, list(answers)
        self.ids: list[str | None] = []
        self.setup_timeouts: list[float] = []

    async def request(self, key: str, message: Any, _: type[Any], timeout: float) -> Verdict:
        if key.startswith("svc/setup"):
            self.setup_timeouts.append(timeout)
            raise self.setup
        assert isinstance(message, Envelope)
        self.ids.append(message.id)
        answer = self.answers.pop(0) if self.answers else UNKNOWN
        if isinstance(answer, PcmrsError):
            raise answer
        return msgspec.structs.replace(answer, id=message.id) if answer.id else answer

    def client(self) -> Client:
        bus = cast("Bus", self)
        return Client(bus, bus, "anna")


UNKNOWN = UnknownOutcomeError("No answer.")
CONNECTED = Verdict(
    id="of the command", branch="robot", operation="connect", decision="accepted", state="1", sequence=1
)
BUSY = msgspec.structs.replace(CONNECTED, id="", decision="rejected", reason=Reason(code="busy", text="Busy."))
"""Rejection before the dispatcher: it has no id, and the daemon has not looked for an earlier verdict."""


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_aio, "_RETRY_PERIOD", 0.01)


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("setup", [DeviceError("No setup."), PayloadError("A later version."), UNKNOWN])
async def test_no_setup_keeps_an_unknown_command_from_resending(setup: PcmrsError) -> None:
    bus = FarBus(setup, UNKNOWN, CONNECTED)
    assert (await bus.client().call("robot.connect", id="a")).decision == "accepted"
    assert bus.ids == ["a", "a"]


@pytest.mark.usefixtures("fast")
async def test_the_question_for_the_role_keeps_the_timeout() -> None:
    bus = FarBus(UNKNOWN)
    with pytest.raises(UnknownOutcomeError):
        await bus.client().call("robot.connect", timeout=0.2)
    (timeout,) = bus.setup_timeouts
    assert 0.0 < timeout <= 0.2


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("second", [DeviceError("It failed."), PayloadError("A later version."), BUSY])
async def test_a_failed_resend_leaves_the_outcome_unknown(second: PcmrsError | Verdict) -> None:
    """It tells nothing of the first attempt, which may have run."""
    bus = FarBus(UNKNOWN, UNKNOWN, second, CONNECTED)
    assert (await bus.client().call("robot.connect", id="a")).decision == "accepted"
    bus = FarBus(UNKNOWN, UNKNOWN, second)
    with pytest.raises(UnknownOutcomeError):
        await bus.client().call("robot.connect", timeout=0.1)


@pytest.mark.parametrize("first", [DeviceError("It failed."), PayloadError("A later version.")])
async def test_an_error_reply_to_the_first_attempt_is_raised(first: PcmrsError) -> None:
    bus = FarBus(UNKNOWN, first)
    with pytest.raises(type(first)):
        await bus.client().call("robot.connect")
    assert len(bus.ids) == 1
    bus = FarBus(UNKNOWN, BUSY)
    assert (await bus.client().call("robot.connect")).decision == "rejected"
