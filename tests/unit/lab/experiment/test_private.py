"""What an experiment says when a command of it is refused."""

from __future__ import annotations

from pathlib import Path

from pcmrs.errors import CommandRefusedError
from pcmrs.journal import Journal
from pcmrs.messages import BlueprintTag, DeviceEvent
from pcmrs.service.restart.recorder import JournalRecorder
from pcmrs.testing.clock import ManualClock
from pcmrs.threads import Load
from pcmrs_lab.experiment.private import explained

TAG = BlueprintTag(id="ratms", version="1.0.0", hash="abc")
REFUSED = CommandRefusedError(
    "execute_motionxx was failed in placement held: daemon_silent.", command="execute_motionxx"
)


async def test_refusal_is_explained_by_last_danger_and_excessive_load(tmp_path: Path) -> None:
    journal = Journal.open(tmp_path / "journal.sqlite", durable=False)
    recorder = JournalRecorder(journal, ManualClock(), "s1", TAG)
    for code, text, danger in (
        ("link_lost", "The link was lost.", True),
        ("daemon_silent", "The node held the arm.", True),
        ("node_restarted", "The node was restarted.", False),
    ):
        await recorder.event(DeviceEvent(device="robot", code=code, text=text, danger=danger), {})
    kept = f" The journal was kept: {tmp_path / 'journal.sqlite'}."
    busy = explained(REFUSED, journal.reader, Load(running=9, processors=2))
    overloaded = " The machine is overloaded: 9 threads want to run on 2 processors."
    assert busy.text == f"{REFUSED.text} The node held the arm.{overloaded}{kept}"
    assert busy.fields == REFUSED.fields
    assert explained(REFUSED, journal.reader, Load(1, 2)).text == f"{REFUSED.text} The node held the arm.{kept}"
    await journal.close()
