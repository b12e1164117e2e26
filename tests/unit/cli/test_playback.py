"""`pcmrs play` publishes what was recorded, byte for byte, where no cell listens."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from pcmrs.bus.codec import pack
from pcmrs.recording.file import RecordingFile, Topics
from pcmrs.testing.daemon import free_port
from tests.unit.bus.bus_cells import new_cell, open_bus, plain_session
from tests.unit.cli.command_line import run

MESSAGES = [("state/event", pack({"device": "robot", "code": str(number), "text": "ü"})) for number in range(4)]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A recording with a message every 10 ms."""
    topics = Topics()
    file = RecordingFile(tmp_path / "run.mcap", topics, {"site": "lab", "cell": "cell7"})
    for number, (key, payload) in enumerate(MESSAGES):
        topics.write_raw(key, number * 0.01, payload, 1_700_000_000 * 10**9 + number * 10**7)
    file.close()
    return tmp_path / "run.mcap"


async def test_every_message_is_published_again_under_replay(recorded: Path) -> None:
    heard: list[tuple[str, bytes]] = []
    async with open_bus(new_cell()) as bus:
        with plain_session(bus.settings) as session:
            subscriber = session.declare_subscriber(
                "pcmrs/**", lambda sample: heard.append((str(sample.key_expr), sample.payload.to_bytes()))
            )
            ended = await asyncio.to_thread(
                run, "play", str(recorded), "--endpoint", bus.settings.endpoint, "--json", "--from", "0.005"
            )
            async with asyncio.timeout(20.0):
                while len(heard) < 3:  # noqa: ASYNC110 - what is waited for comes in a thread of Zenoh's
                    await asyncio.sleep(0.01)
            subscriber.undeclare()  # type: ignore[no-untyped-call]
    assert ended.exit_code == 0, ended.output
    played = json.loads(ended.stdout)
    assert (played["messages"], played["prefix"], played["damage"]) == (3, "pcmrs/replay/cell7", [])
    assert heard == [(f"pcmrs/replay/cell7/{key}", payload) for key, payload in MESSAGES[1:]]


@pytest.mark.parametrize("end", ["1", "2"])
def test_an_excerpt_that_ends_before_it_begins_is_refused(recorded: Path, end: str) -> None:
    ended = run("play", str(recorded), "--from", "2", "--to", end)
    assert ended.exit_code == 2
    assert f"--to {end} must be later than --from 2" in ended.stderr


def test_a_file_that_is_no_recording_is_named(tmp_path: Path) -> None:
    (tmp_path / "other.mcap").write_bytes(b"no recording")
    for name in ("other.mcap", "none.mcap"):
        ended = run("play", str(tmp_path / name))
        assert ended.exit_code == 5
        assert name in ended.stderr
        assert len(ended.stderr.splitlines()) == 1


def test_without_a_router_the_status_is_3(recorded: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    ended = run("play", str(recorded), "--endpoint", endpoint)
    assert ended.exit_code == 3
    assert endpoint in ended.stderr
