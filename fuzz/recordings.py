"""Recordings: MCAP files that `pcmrs play`, `pcmrs repair` and the console read, up to the console's display.

python -m fuzz.recordings -max_total_time=60
"""

from __future__ import annotations

import tempfile
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mcap.writer import CompressionType, Writer

from fuzz.running import instrumented, run

with instrumented("mcap", "pcmrs.recording", "pcmrs.console.playback", "pcmrs.console._cell_view_model"):
    from pcmrs.console.playback import Playback, load_recording
    from pcmrs.errors import PcmrsError
    from pcmrs.fsm import parse_blueprint
    from pcmrs.recording import raw
    from pcmrs.recording.file import METADATA
    from pcmrs.recording.playback import read_cell_name
    from pcmrs.recording.reader import RecordingReader
    from pcmrs.recording.repair import repair

BLUEPRINT = parse_blueprint((Path(__file__).parents[1] / "pcmrs" / "workflows" / "ratms.toml").read_bytes())
SETUP: Any = SimpleNamespace(arm=SimpleNamespace(name="iiwa14", joints=range(7)))
KEYS = ("fsm", "event", "target", "data", "epoch", "health", "joints", "pose/coil")
FOLDER = tempfile.TemporaryDirectory(prefix="fuzz-recordings-")


def one(data: bytes) -> None:
    """Read a recording; the first byte selects if the rest is a file, or messages of one."""
    path, rest = Path(FOLDER.name, "run.mcap"), data[1:]
    if data[:1] < b"\x80":
        path.write_bytes(rest)
    else:
        write(path, rest)
    with suppress(PcmrsError):
        read_cell_name(path)
    with suppress(PcmrsError):
        recorded = load_recording([path], lambda _: None)
        page = Playback(recorded, SETUP, BLUEPRINT)
        page.seek(recorded.duration / 2)
        page.seek(recorded.duration)
    check_repair(path)


def write(path: Path, data: bytes) -> None:
    """Write a file of messages: a byte for the key, two for the time and two for the length, then the payload.

    Args:
        path: File to write.
        data: Fuzzed bytes.
    """
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=CompressionType.NONE, use_chunking=False)
        writer.start()
        writer.add_metadata(METADATA, {"cell": "x"})
        channels = [writer.register_channel(f"{raw.PREFIX}state/{key}", "protobuf", 0) for key in KEYS]
        while len(data) > 5:
            key, time, size = data[0] % len(KEYS), int.from_bytes(data[1:3]), int.from_bytes(data[3:5])
            content = raw.encode(time / 1e3, data[5 : 5 + size])
            writer.add_message(channels[key], time * 1_000_000, content, time * 1_000_000)
            data = data[5 + size :]
        writer.finish()


def check_repair(path: Path) -> None:
    """Check that a repaired file is complete, and has every message that was saved."""
    repaired_path = path.with_name("repaired.mcap")
    repaired_path.unlink(missing_ok=True)
    with suppress(PcmrsError):
        repaired = repair(path, repaired_path)
        again = RecordingReader(repaired_path)
        count = sum(type(record).__name__ == "Message" for record in again.records())
        assert again.complete, again.damage
        assert count == repaired.messages


if __name__ == "__main__":
    run(one)
