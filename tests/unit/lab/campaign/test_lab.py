"""One daemon serves many faults, and none that a fault has spoilt serves another."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.lab import Lab, Pool


class Daemons:
    """Stand-ins for daemons: how many have begun and ended, and which cannot be brought back to the start."""

    def __init__(self) -> None:
        self.begun: list[Any] = []
        self.ended: list[Any] = []
        self.spoilt: set[Any] = set()
        self.seeds: list[int] = []

    @asynccontextmanager
    async def open_cell(
        self, folder: Path, overrides: Sequence[str], *, environment: Mapping[str, str]
    ) -> AsyncIterator[Any]:
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
