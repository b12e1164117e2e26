"""One daemon serves many faults, and none that a fault has spoilt serves another."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign import lab as surroundings
from pcmrs_lab.campaign.lab import Lab, Pool
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started


class Daemons:
    """Stand-ins for daemons: how many have begun and ended, and which cannot be brought back to the start."""

    def __init__(self) -> None:
        self.begun: list[Any] = []
        self.ended: list[Any] = []
        self.spoilt: set[Any] = set()
        self.seeds: list[int] = []
        self.opened: list[tuple[Path, tuple[str, ...], Mapping[str, str]]] = []

    @asynccontextmanager
    async def open_cell(
        self, folder: Path, overrides: Sequence[str], *, environment: Mapping[str, str], **_: Any
    ) -> AsyncIterator[Any]:
        self.opened.append((folder, tuple(overrides), environment))
        cell = Stand(self)
        self.begun.append(cell)
        yield cell
        self.ended.append(cell)

    async def start_anew(self, client: Any) -> None:
        if client in self.spoilt:
            raise Unmet("It cannot be brought back.")


class Stand:
    def __init__(self, daemons: Daemons) -> None:
        self._daemons = daemons
        self.scene = self.client = self

    async def reseed(self, seed: int) -> None:
        self._daemons.seeds.append(seed)


@pytest.fixture
def daemons(monkeypatch: pytest.MonkeyPatch) -> Daemons:
    made = Daemons()
    monkeypatch.setattr("pcmrs_lab.campaign.lab.open_cell", made.open_cell)
    monkeypatch.setattr("pcmrs_lab.campaign.lab.reset_cell", made.start_anew)
    return made


async def test_faults_that_ask_for_the_same_settings_share_a_daemon(tmp_path: Path, daemons: Daemons) -> None:
    pool = Pool(tmp_path)
    for seed, settings in ((1, ("a=1",)), (2, ("a=1",)), (3, ("a=2",)), (4, ("a=1",))):
        async with Lab(seed, tmp_path, pool).cell(*settings):
            pass
    assert (len(daemons.begun), len(daemons.ended), daemons.seeds) == (3, 2, [1, 2, 3, 4])
    await pool.close()
    assert daemons.ended == daemons.begun


async def test_a_daemon_in_which_a_fault_failed_is_ended(tmp_path: Path, daemons: Daemons) -> None:
    pool = Pool(tmp_path)
    lab = Lab(1, tmp_path, pool)
    with pytest.raises(Unmet, match="moves"):
        async with lab.cell():
            raise Unmet("It moves.")
    assert daemons.ended == daemons.begun
    async with lab.cell():
        assert len(daemons.begun) == 2
    await pool.close()


async def test_daemon_spoilt_by_a_fault_is_not_used_again(tmp_path: Path, daemons: Daemons) -> None:
    pool = Pool(tmp_path)
    lab = Lab(1, tmp_path, pool)
    async with lab.cell():
        pass
    daemons.spoilt.update(daemons.begun)
    async with lab.cell() as cell:
        assert cell not in daemons.spoilt
    assert len(daemons.begun) == 2
    await pool.close()


@pytest.mark.parametrize(("error", "kept"), [(Unmet("Nothing happened."), True), (KeyError("crash"), False)])
async def test_a_row_without_its_fault_damages_no_daemon(
    tmp_path: Path, daemons: Daemons, error: Exception, kept: bool
) -> None:
    pool = Pool(tmp_path)
    with sham(), pytest.raises(type(error)):
        async with Lab(1, tmp_path, pool).cell():
            raise error
    assert bool(daemons.ended) is not kept
    await pool.close()


async def test_delayed_processes_are_not_those_of_other_rows(tmp_path: Path, daemons: Daemons) -> None:
    pool = Pool(tmp_path)
    for delayed in (False, True, True):
        async with Lab(1, tmp_path, pool).cell(delayed=delayed):
            pass
    assert len(daemons.begun) == 2
    first, second = (environment for _, _, environment in daemons.opened)
    assert first == {}
    assert second
    await pool.close()


async def test_a_resting_tool_may_stay_where_it_is(
    tmp_path: Path, daemons: Daemons, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepared: list[str] = []

    async def reset(_: Any) -> None:
        prepared.append("reset")

    async def rest(_: Any) -> None:
        prepared.append("rest")

    monkeypatch.setattr(surroundings, "reset_cell", reset)
    monkeypatch.setattr(surroundings, "wait_until_stationary", rest)
    pool = Pool(tmp_path)
    for fresh in (True, False):
        async with Lab(1, tmp_path, pool).cell(fresh=fresh):
            pass
    assert prepared == ["reset", "rest"]
    assert len(daemons.begun) == 1
    await pool.close()


async def test_each_new_daemon_has_a_folder_and_the_seed(tmp_path: Path, daemons: Daemons) -> None:
    lab = Lab(7, tmp_path)
    async with lab.daemon("a=1"), lab.daemon(folder=tmp_path / "cell1", environment={"A": "1"}):
        pass
    (first, settings, _), (second, _, environment) = daemons.opened
    assert (first, second) == (tmp_path / "cell1", tmp_path / "cell1"), "a successor uses the folder of another one"
    assert settings == ("sim.seed=7", "a=1")
    assert environment == {"A": "1"}


def test_a_lab_draws_by_its_seed(tmp_path: Path) -> None:
    first, again, other = (Lab(seed, tmp_path).random.random() for seed in (1, 1, 2))
    assert first == again != other


async def test_a_daemon_that_refuses_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild()
    child.returncode = 4

    async def communicate() -> tuple[bytes, bytes]:
        return b"", b"Error: the key is readable \xff.\n"

    monkeypatch.setattr(child, "communicate", communicate)
    started(monkeypatch, child)
    status, errors = await Lab(1, tmp_path).start_refused("a=1", folder=tmp_path / "old")
    assert (status, errors) == (4, "Error: the key is readable \N{REPLACEMENT CHARACTER}.\n")
    assert "a=1" in child.words
    assert any(str(tmp_path / "old") in word for word in child.words)


async def test_a_daemon_that_starts_after_all_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    child = ScriptedChild()
    ended: list[ScriptedChild] = []

    async def communicate() -> tuple[bytes, bytes]:
        await asyncio.Event().wait()
        return b"", b""

    async def end(process: ScriptedChild) -> None:
        ended.append(process)

    monkeypatch.setattr(child, "communicate", communicate)
    monkeypatch.setattr(surroundings, "END_TIME", 0.01)
    monkeypatch.setattr(surroundings, "kill_and_wait", end)
    started(monkeypatch, child)
    with pytest.raises(Unmet, match="started although it had to refuse"):
        await Lab(1, tmp_path).start_refused()
    assert ended == [child]


def test_the_log_of_the_newest_daemon_is_shown(tmp_path: Path) -> None:
    lab = Lab(1, tmp_path)
    assert lab.log_tail() == ""
    for age, (name, text) in enumerate((("shared1", "of the last fault"), ("cell1", "of this fault"))):
        (tmp_path / name).mkdir()
        log = tmp_path / name / "log"
        log.write_text("\n".join(f"{text} {number}" for number in range(9)))
        os.utime(log, (1e9 + age, 1e9 + age))
    shown = lab.log_tail()
    assert "of this fault 8" in shown
    assert "of this fault 1" not in shown
    assert "of the last fault" not in shown
