"""A daemon killed in a motion, and what its successor restores, shows and refuses until an operator has looked."""

from __future__ import annotations

import asyncio
import json
import signal
from pathlib import Path

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalReader
from pcmrs.testing.driving import accept, moving, register, showing, to_standoff, until
from tests.system.daemon.daemon_process import SLOW, own_settings, running_daemon, wait_until


def damage(journal: Path) -> None:
    content = bytearray(journal.read_bytes())
    content[content.index(b"phantom")] ^= 1  # in the configuration that the first row tells
    journal.write_bytes(content)


def damage_told(journal: Path) -> bool:
    with JournalReader(journal) as reader:
        return any(stored.row.operation == "journal_damaged" for stored in reader.read(kind="device"))


async def test_kill_in_a_motion_bars_motion_until_it_is_acknowledged(
    tmp_path: Path,
) -> None:
    """The operator has the arm located before."""
    settings = [*own_settings(tmp_path), *SLOW]
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await register(client)
            async with moving(client) as approach:
                daemon.end(signal.SIGKILL)
                with pytest.raises(UnknownOutcomeError):
                    await approach
    with running_daemon(settings, tmp_path) as successor:
        async with successor.client() as client:
            state = await client.state()
            assert (state.branches["robot"], state.branches["placement"]) == ("0", "unknown")
            assert (state.registration, state.plan, state.latched) == (None, None, True)
            (lost,) = state.unknown
            assert (lost.branch, lost.operation) == ("placement", "approach")
            shown = successor.pcmrs("state").stdout
            assert "unknown: placement.approach" in shown
            assert lost.command in shown
            assert json.loads(successor.pcmrs("state", "--json").stdout)["unknown"][0]["command"] == lost.command
            assert "unknown_outcome" in successor.log
            # Only what an operator asks for is taken back.
            await accept(client, "registration.use_previous")
            await accept(client, "toolplan.use_previous")
            await accept(client, "robot.connect")
            await until(client, showing(placement="retracted"))
            assert (await client.state()).unknown == [], "locating the arm has settled it"
            refused = await client.call("placement.approach")
            assert refused.reason is not None
            assert refused.reason.code == "latched"
            await accept(client, "robot.acknowledge")
            assert not (await client.state()).latched
        assert successor.end() == 0
    with JournalReader(tmp_path / "ratms.sqlite") as journal:
        rows = [stored.row for stored in journal.read()]
    assert [row.operation for row in rows if row.kind == "config"] == ["started", "started"]
    assert rows[-1].kind == "snapshot"
    assert rows[-1].result is not None
    assert (rows[-1].result["latched"], rows[-1].result["unknown"]) == (False, [])
    with running_daemon([*settings, "procedure.patient=somebody else", "procedure.body.surface="], tmp_path) as other:
        async with other.client() as client:
            assert not (await client.state()).latched, "the Stop of an orderly end leaves nothing to acknowledge"
            for name in ("registration.use_previous", "toolplan.use_previous"):
                verdict = await client.call(name)
                assert verdict.reason is not None
                assert verdict.reason.code == "other_patient"


async def test_kill_while_guiding_bars_motion_until_it_is_acknowledged(
    tmp_path: Path,
) -> None:
    def begun() -> bool:
        """Nothing moves before this row is on the disk, some time after the verdict."""
        with JournalReader(tmp_path / "ratms.sqlite") as journal:
            return any(stored.row.operation == "activity_started" for stored in journal.read(kind="device"))

    settings = own_settings(tmp_path)
    with running_daemon(settings, tmp_path) as daemon:
        async with daemon.client() as client:
            await to_standoff(client)
            await accept(client, "placement.guide")
            assert await asyncio.to_thread(wait_until, begun)
            daemon.end(signal.SIGKILL)
    with running_daemon(settings, tmp_path) as successor:
        async with successor.client() as client:
            state = await client.state()
            assert state.latched
            (lost,) = state.unknown
            assert (lost.branch, lost.operation) == ("placement", "teleoperate")
            await accept(client, "robot.connect")
            await until(client, showing(placement="retracted"))
            refused = await client.call("placement.home")
            assert refused.reason is not None
            assert refused.reason.code == "latched"


@pytest.mark.nightly
async def test_old_damage_is_reported_after_the_start_and_bars_nothing(tmp_path: Path) -> None:
    settings = own_settings(tmp_path)
    with running_daemon(settings, tmp_path) as daemon:
        journal = Path(daemon.ready.journal)
        assert daemon.end() == 0
    damage(journal)
    with running_daemon(settings, tmp_path) as successor:
        async with successor.client() as client:
            assert await asyncio.to_thread(wait_until, lambda: damage_told(journal))
            assert not (await client.state()).latched
            await accept(client, "robot.connect")
