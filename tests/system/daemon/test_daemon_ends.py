"""How a daemon ends when a signal asks it to, and when the program that started it is killed."""

from __future__ import annotations

import asyncio
import signal
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.journal import JournalReader, JournalRow
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.driving import moving, register
from tests.system.daemon.daemon_process import SLOW, is_running, own_settings, running_daemon, wait_until


def _rows(folder: Path) -> list[JournalRow]:
    with JournalReader(folder / "ratms.sqlite") as journal:
        return [stored.row for stored in journal.read(after=0)]


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.nightly)])
async def test_a_signal_holds_the_motion_before_everything_ends(tmp_path: Path, number: int) -> None:
    with running_daemon([*own_settings(tmp_path), *SLOW, *LIGHT], tmp_path) as daemon:
        nodes = [*daemon.children(), daemon.heart()]
        async with daemon.client() as client:
            await register(client)
            async with moving(client) as approach:
                status = await asyncio.to_thread(daemon.end, number)
                with suppress(UnknownOutcomeError):  # the bus may be closed before the answer is through
                    assert (await approach).state == "held"
        assert status == 0
        assert nodes
        assert not any(map(is_running, nodes))
        assert "Traceback" not in daemon.log
    outcome = next(row for row in reversed(_rows(tmp_path)) if row.operation == "approach" and row.verdict)
    assert outcome.verdict is not None
    assert outcome.verdict.decision == "failed"
    assert outcome.verdict.state == "held"


STARTER = """
import asyncio, sys
from pathlib import Path
from pcmrs.testing.cell import LIGHT
from pcmrs.testing.daemon import own_settings, running_daemon

async def main(folder):
    async with running_daemon([*own_settings(folder / "cell", "left"), *LIGHT], folder / "log") as daemon:
        print(daemon.process.pid, flush=True)
        await asyncio.sleep(3600)

asyncio.run(main(Path(sys.argv[1])))
"""


async def test_daemon_ends_when_the_program_that_started_it_is_killed(tmp_path: Path) -> None:
    """A campaign that somebody breaks off leaves nothing running, nor any port taken."""
    (tmp_path / "cell").mkdir()
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", STARTER, str(tmp_path), stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    daemon = int(await process.stdout.readline())
    assert is_running(daemon)
    process.kill()
    await process.wait()
    assert await asyncio.to_thread(wait_until, lambda: not is_running(daemon), 30.0)
