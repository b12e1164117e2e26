"""The daemon on the bus, as a client of PCMRS and as a plain Zenoh tool see it."""

from __future__ import annotations

import asyncio
import json
import queue
from collections.abc import AsyncIterator, Iterator
from contextlib import aclosing, contextmanager
from typing import Any

import msgspec
import pytest
import zenoh

from pcmrs.bus.keys import KEYS
from pcmrs.client import Client, Event
from pcmrs.messages import BodyPose, JointState, Snapshot, Verdict
from pcmrs.testing.driving import accept, landmarks
from tests.system.daemon.daemon_process import PATIENCE, ServeProcess


class Events:
    """Verdicts and device events as they come on ``state/event``, as plain data."""

    def __init__(self, session: zenoh.Session, prefix: str) -> None:
        self._session = session
        self._prefix = prefix
        self._received: queue.Queue[dict[str, Any]] = queue.Queue()
        session.declare_subscriber(f"{prefix}/state/event", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        self._received.put(msgspec.msgpack.decode(sample.payload.to_bytes()))

    def put(self, key: str, payload: bytes | str) -> None:
        self._session.put(f"{self._prefix}/{key}", payload)

    def snapshot(self) -> dict[str, Any]:
        """The daemon's answer to a query for its state."""
        answer: dict[str, Any] = _answer(self._session, f"{self._prefix}/svc/snapshot")
        return answer

    def wait_for(self, **fields: Any) -> dict[str, Any]:
        """The next event with these fields."""
        while True:
            event = self._received.get(timeout=PATIENCE)
            if fields.items() <= event.items():
                return event


@contextmanager
def _events(daemon: ServeProcess) -> Iterator[Events]:
    with daemon.plain_session() as session:
        yield Events(session, daemon.ready.prefix)


def _answer(session: zenoh.Session, key: str, payload: str | None = None) -> Any:
    (reply,) = session.get(key, payload=payload, timeout=PATIENCE)
    assert reply.ok is not None
    return json.loads(reply.ok.payload.to_bytes())


async def _first(events: AsyncIterator[Event], kind: type[Event], **fields: Any) -> Any:
    async with asyncio.timeout(PATIENCE):
        async for event in events:
            if isinstance(event, kind) and all(getattr(event, name) == value for name, value in fields.items()):
                return event
    raise AssertionError("the stream of events has ended")


async def test_a_late_joiner_gets_the_snapshot_and_then_every_decision(daemon: ServeProcess, client: Client) -> None:
    await accept(client, "registration.plan_landmarks", **landmarks())
    async with daemon.client() as late, aclosing(late.watch()) as events:
        snapshot = await _first(events, Snapshot)
        assert snapshot.branches["registration"] == "100"
        assert snapshot == await late.state()
        verdict = await accept(client, "registration.clear_landmarks")
        # Events are never dropped and go first, of snapshots only the newest counts: either may come before the other.
        shown: set[type[Event]] = set()
        async with asyncio.timeout(PATIENCE):
            while shown != {Snapshot, Verdict}:
                event = await anext(events)
                if isinstance(event, Snapshot) and event.sequence == verdict.sequence:
                    assert event.branches["registration"] == "000"
                    shown.add(Snapshot)
                elif isinstance(event, Verdict) and event.id == verdict.id:
                    assert event == verdict
                    shown.add(Verdict)


def test_json_put_by_hand_is_decided_and_its_verdict_is_an_event(daemon: ServeProcess) -> None:
    with _events(daemon) as events:
        events.put("cmd/operator/toolplan/clear", json.dumps({"id": "by-hand-1"}))
        verdict = events.wait_for(id="by-hand-1")
        assert (verdict["decision"], verdict["branch"], verdict["state"]) == ("accepted", "toolplan", "0")
        events.put("cmd/operator/placement/confirm", "{}")
        refused = events.wait_for(operation="confirm")
        assert refused["decision"] == "rejected"
        assert refused["reason"]["text"]
        events.put("cmd/operator/registration/clear_landmarks", b"")
        assert events.wait_for(operation="clear_landmarks")["decision"] == "accepted"


@pytest.mark.parametrize(
    ("key", "payload"),
    [
        ("cmd/operator/registration/plan_landmarks", "{not json"),
        ("cmd/operator/registration/plan_landmarks", b"\xc1\xff\x00"),
        ("cmd/operator/registration/plan_landmarks", '{"argumnts": {}}'),
        ("cmd/operator/registration/plan_landmarks", '{"arguments": {"landmarks": []}}'),
        ("cmd/operator/registration/plan_landmarks", '{"arguments": {"landmarks": [{"name": 5}]}}'),
        ("cmd/operator/toolplan/plan", '{"arguments": {"position": [0, 0, 1e999], "quat_xyzw": [0, 0, 0, 1]}}'),
        ("cmd/operator/digitization/digitize_one", '{"arguments": {"index": 99}}'),
        ("cmd/operator/registration/digitized", "{}"),
        ("cmd/operator/robot/link_lost", "{}"),
        ("cmd/operator/robot/explode", "{}"),
        ("cmd/operator/elbow/bend", "{}"),
        ("cmd/operator/toolplan/clear", '{"sent": 1.0, "ttl": 1.0}'),
    ],
)
def test_invalid_command_is_refused_readably_and_changes_nothing(
    daemon: ServeProcess, key: str, payload: str | bytes
) -> None:
    with _events(daemon) as events:
        before = events.snapshot()
        events.put(key, payload)
        verdict = events.wait_for(operation=key.rpartition("/")[2])
        assert verdict["decision"] == "rejected"
        assert verdict["reason"]["code"]
        assert len(verdict["reason"]["text"]) > 20
        assert events.snapshot() == before


def test_a_query_in_json_is_answered_in_json(daemon: ServeProcess) -> None:
    with daemon.plain_session() as session:
        key = f"{daemon.ready.prefix}/cmd/operator/toolplan/clear"
        verdict = _answer(session, key, '{"id": "asked-1"}')
        assert (verdict["id"], verdict["decision"]) == ("asked-1", "accepted")
        assert _answer(session, f"{daemon.ready.prefix}/svc/snapshot")["sequence"] >= verdict["sequence"]


async def test_repeated_id_runs_nothing_and_gets_the_recorded_verdict(client: Client) -> None:
    first = await client.call("registration.plan_landmarks", landmarks(), id="once")
    await accept(client, "registration.clear_landmarks")
    sequence = (await client.state()).sequence
    assert await client.call("registration.plan_landmarks", landmarks(), id="once") == first
    state = await client.state()
    assert state.sequence == sequence
    assert state.branches["registration"] == "000"


def test_every_process_of_the_cell_is_alive_on_the_bus(daemon: ServeProcess) -> None:
    with daemon.plain_session() as session:
        replies = session.liveliness().get(f"{daemon.ready.prefix}/alive/*", timeout=PATIENCE)
        alive = {str(reply.ok.key_expr).rpartition("/")[2] for reply in replies if reply.ok is not None}
    assert alive == {"daemon", "node-sim"}


async def test_the_streams_carry_joints_and_poses(daemon: ServeProcess) -> None:
    joints: list[JointState] = []
    poses: dict[str, BodyPose] = {}
    complete = asyncio.Event()

    def take_joints(_key: str, state: JointState) -> None:
        joints.append(state)

    def take_pose(_key: str, pose: BodyPose) -> None:
        poses[pose.body] = pose
        if len(poses) == 4 and joints:
            complete.set()

    async with daemon.bus() as bus:
        bus.subscribe("state/joints", JointState, take_joints)
        bus.subscribe("state/pose/*", BodyPose, take_pose)
        async with asyncio.timeout(PATIENCE):
            await complete.wait()
    assert poses["coil"].valid
    assert poses["body_ref"].valid
    assert poses["witness"].valid
    assert not poses["pointer"].valid
    assert poses["pointer"].reason


async def test_the_key_table_lists_what_there_is(daemon: ServeProcess, client: Client) -> None:
    table = await client.keys()
    assert table.prefix == daemon.ready.prefix
    assert table.keys == KEYS
