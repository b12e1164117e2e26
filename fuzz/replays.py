"""Exports of other machines' journals, replayed like `pcmrs journal replay`.

python -m fuzz.replays -max_total_time=60
"""

from __future__ import annotations

import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from unittest.mock import patch

from fuzz.running import instrumented, run

with instrumented("pcmrs.replay", "pcmrs.journal"):
    from pcmrs.clock import SystemClock
    from pcmrs.errors import JournalError, ReplayError
    from pcmrs.replay import replay
    from pcmrs.workflows.opening import open_installed

OPENED = cache(open_installed)  # verifying it takes seconds
FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-replays-")


def one(data: bytes) -> None:
    """Replay an export, or refuse it as not replayable."""
    path = Path(FOLDER.name, "journal.jsonl")
    path.write_bytes(data)
    with suppress(JournalError, ReplayError), patch("pcmrs.replay.replay.open_installed", OPENED):
        replay(path, SystemClock())


if __name__ == "__main__":
    run(one)
