"""A daemon killed in a motion, and what its successor restores, shows and refuses until an operator has looked."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalReader
from pcmrs.messages import Snapshot, Verdict
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import accept, landmarks, moving, register, showing, tool_pose, until
from pcmrs.testing.simulated import CellInSimulatedTime
from pcmrs_sim.deterministic.cell import SimulatedCell
from tests.system.daemon.daemon_process import (
    SLOW,
    ServeProcess,
    is_running,
    own_settings,
    running_daemon,
    wait_until,
)
from tests.unit.sim.deterministic.simulated_cells import in_cell

NODE_ENDS_WITHIN = 2.0


def damage(journal: Path) -> None:
    content = bytearray(journal.read_bytes())
    content[content.index(b"phantom")] ^= 1  # in the configuration that the first row tells
    journal.write_bytes(content)


def damage_told(journal: Path) -> bool:
    with JournalReader(journal) as reader:
        return any(stored.row.operation == "journal_damaged" for stored in reader.read(kind="device"))


@dataclass
class Killed:
    """What was seen of a daemon that was killed in a motion, and of its successor.

    Attributes:
        folder: Of the cell.
        settings: Of both daemons.
        ended: Whether the nodes and the heart of the first one ended by themselves in time.
        decided: Verdict of the first one on a command, and that of the successor on its repetition.
        state: Of the successor before anybody commanded anything.
        successor: The running successor.
    """

    folder: Path
    settings: list[str]
    ended: bool
    decided: list[Verdict]
    state: Snapshot
    successor: ServeProcess


async def approach_and_kill(daemon: ServeProcess) -> Verdict:
    async with daemon.client() as client:
        decided = await client.call("registration.clear_landmarks", id="before-the-crash")
        await register(client)
        async with moving(client) as approach:
            daemon.end(signal.SIGKILL)
            with pytest.raises(UnknownOutcomeError):
                await approach
    return decided


async def look_at(successor: ServeProcess) -> tuple[Snapshot, Verdict]:
    async with successor.client() as client:
        state = await client.state()
        return state, await client.call("registration.clear_landmarks", id="before-the-crash")


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killed]:
    folder = tmp_path_factory.mktemp("cell")
    settings = [*own_settings(folder), *SLOW, *LIGHT]
    with running_daemon(settings, folder) as daemon:
        nodes = [*daemon.children(), daemon.heart()]
        decided = asyncio.run(approach_and_kill(daemon))
        ended = wait_until(lambda: not any(map(is_running, nodes)), NODE_ENDS_WITHIN)
    with running_daemon(settings, folder) as successor:
        state, again = asyncio.run(look_at(successor))
        yield Killed(folder, settings, ended, [decided, again], state, successor)


def test_nodes_end_by_themselves_after_the_daemon_is_killed(killed: Killed) -> None:
    """Their successor does not know where the arm is."""
    assert killed.ended
    assert killed.state.branches == {
        "registration": "000",
        "digitization": "0",
        "toolplan": "0",
        "robot": "0",
        "placement": "unknown",
        "alignment": "0",
        "teleoperation": "off",
    }
    assert (killed.state.registration, killed.state.plan, killed.state.latched) == (None, None, True)
    assert killed.decided[0] == killed.decided[1]
    with JournalReader(killed.folder / "ratms.sqlite") as journal:
        (lost,) = (each.row for each in journal.read() if each.row.verdict and each.row.verdict.decision == "unknown")
    assert (lost.branch, lost.operation) == ("placement", "approach")


async def test_kill_in_a_motion_bars_motion_until_it_is_acknowledged(killed: Killed) -> None:
    """The operator has the arm located before."""
    successor = killed.successor
    (lost,) = killed.state.unknown
    assert (lost.branch, lost.operation) == ("placement", "approach")
    async with successor.client() as client:
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
    assert "Traceback" not in successor.log
    with JournalReader(killed.folder / "ratms.sqlite") as journal:
        rows = [stored.row for stored in journal.read()]
    assert [row.operation for row in rows if row.kind == "config"] == ["started", "started"]
    assert rows[-1].kind == "snapshot"
    assert rows[-1].result is not None
    assert (rows[-1].result["latched"], rows[-1].result["unknown"]) == (False, [])
    somebody_else = ("procedure.patient=somebody else", "procedure.body.surface=")
    with running_daemon([*killed.settings, *somebody_else], killed.folder) as other:
        async with other.client() as client:
            assert not (await client.state()).latched, "the Stop of an orderly end leaves nothing to acknowledge"
            for name in ("registration.use_previous", "toolplan.use_previous"):
                verdict = await client.call(name)
                assert verdict.reason is not None
                assert verdict.reason.code == "other_patient"


def test_kill_while_guiding_bars_motion_until_it_is_acknowledged(tmp_path: Path) -> None:
    """In simulated time: what is decided is the same as with processes, which the other tests kill."""

    async def play(cell: SimulatedCell, client: CellInSimulatedTime) -> None:
        await client.accept("registration.plan_landmarks", **landmarks())
        await client.accept("digitization.digitize_all")
        await client.accept("registration.register")
        await client.accept("toolplan.plan", **tool_pose())
        await client.accept("robot.connect")
        await client.until(lambda shown: shown.branches["placement"] == "retracted" and not shown.running)
        await client.accept("placement.approach")
        await client.accept("placement.guide")
        await client.until(lambda shown: bool(shown.activities))
        await client.crash()
        state = client.snapshot
        assert state.latched
        (lost,) = state.unknown
        assert (lost.branch, lost.operation) == ("placement", "teleoperate")
        await client.accept("robot.connect")
        await client.until(lambda shown: shown.branches["placement"] == "held")
        refused = await client.call("placement.back_off")
        assert refused.reason is not None
        assert refused.reason.code == "latched"

    in_cell(play, tmp_path)


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
