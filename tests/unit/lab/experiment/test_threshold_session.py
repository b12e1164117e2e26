"""A session: who asks waits where it is too early, the journal is read as it was written, the folder holds it all."""

from __future__ import annotations

import asyncio
import hashlib
import json
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import msgspec
import pytest
from click.testing import CliRunner

from pcmrs.analysis.session import SessionRecord
from pcmrs.cli import main
from pcmrs.client import Client
from pcmrs.errors import CommandRefusedError, ConfigurationError, JournalError
from pcmrs.formats.mesh import Mesh
from pcmrs.journal import JournalReader, JournalRow, StoredRow
from pcmrs.journal.writer import JournalWriter
from pcmrs.messages import BlueprintTag, PoseMessage, Reason, SceneTruth, Snapshot, Verdict
from pcmrs.report.session_folder import JOURNAL, ROWS, SUMS, make_folder, write_configuration, write_journal
from pcmrs.report.session_journal import SessionJournal
from pcmrs.report.stimulation.reading import StimulationSession
from pcmrs.settings import read_settings
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment.session import operator as operating
from pcmrs_lab.experiment.session.operator import SessionOperator
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.threshold_session import INTERRUPTED, read_record, run_threshold_session, true_of

TAG = BlueprintTag(id="ratms_threshold", version="1.0.0", hash="ab" * 32)
HERE = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
QUICK = (
    "procedure.max_pose_age=0.6",  # a test machine that does much else may leave a process alone for so long
    "procedure.motion.joint_speed_fraction=1.0",
    "procedure.motion.joint_acceleration=5.0",
    "procedure.motion.linear_velocity=0.5",
    "procedure.placement.frames=5",
    "procedure.placement.tolerance_mm=0.5",  # of so few frames the mean is no better
    "procedure.placement.tolerance_deg=0.2",
    "procedure.registration.samples=5",
    "procedure.stimulation.intervals.least=1.1",
    "procedure.stimulation.threshold.interval=0.3",
    "sim.digitization.reach_time=0.1",
    "sim.digitization.rest_time=0.1",
)


def setup(**given: Any) -> SessionSetup:
    return SessionSetup(read_plan(example_plan("ratms")), **given)


# Who asks ------------------------------------------------------------------------------------------------------------


def rejected(code: str, **fields: Any) -> tuple[str, Reason]:
    return "rejected", Reason(code=code, text=f"It is {code}.", fields=fields)


class FakeClient:
    """A daemon that answers as it is told, and accepts what it is told nothing of.

    Attributes:
        answers: By operation, in order.
        leads: State that an accepted operation leads to, by operation.
    """

    def __init__(self) -> None:
        self.answers: dict[str, list[tuple[str, Reason | None]]] = {}
        self.leads: dict[str, dict[str, str]] = {}
        self.branches = {"placement": "placed", "stimulation": "disarmed", "alignment": "1"}
        self.asked: list[str] = []
        self.latched = False

    async def acknowledge(self) -> Verdict:
        return await self.call("robot.acknowledge")

    async def call(self, name: str, arguments: object = None) -> Verdict:
        self.asked.append(name)
        branch, _, operation = name.partition(".")
        decision, reason = self.answers[name].pop(0) if self.answers.get(name) else ("accepted", None)
        if decision == "accepted":
            self.branches |= self.leads.get(name, {})
        state = self.branches.get(branch, "")
        return msgspec.convert(
            {"id": "1", "branch": branch, "operation": operation, "decision": decision, "state": state, "sequence": 1}
            | ({} if reason is None else {"reason": msgspec.to_builtins(reason)}),
            Verdict,
        )

    async def state(self) -> Snapshot:
        return Snapshot(sequence=1, branches=self.branches, flags={}, running=[], latched=self.latched, blueprint=TAG)

    def listen(self, key: str, kind: type, handler: Callable[[Any], None]) -> None:
        pass


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> FakeClient:
    monkeypatch.setattr(operating, "PAUSE", 0.001)
    made = FakeClient()
    made.leads = {
        "placement.locate": {"placement": "retracted"},
        "placement.approach": {"placement": "standoff"},
        "placement.confirm": {"placement": "placed"},
        "placement.back_off": {"placement": "retracted"},
        "stimulation.arm": {"stimulation": "armed"},
    }
    return made


def operator(client: FakeClient) -> SessionOperator:
    return SessionOperator(cast(Client, client), rate=1000.0)


async def test_temporary_rejection_is_waited_out(client: FakeClient) -> None:
    client.answers["hotspot.pulse"] = [
        rejected("not_aligned"),
        rejected("pulse_too_soon", wait=4.0),
        ("accepted", None),
    ]
    assert (await operator(client).request("hotspot.pulse")).decision == "accepted"
    assert client.asked == ["hotspot.pulse"] * 3


async def test_permanent_rejection_raises(client: FakeClient) -> None:
    client.answers["hotspot.pulse"] = [rejected("too_many_pulses")]
    with pytest.raises(CommandRefusedError, match=r"hotspot\.pulse was rejected .*It is too_many_pulses"):
        await operator(client).request("hotspot.pulse")


async def test_patience_ends(client: FakeClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operating, "PATIENCE", 0.0)
    client.answers["hotspot.pulse"] = [rejected("not_aligned")] * 50
    with pytest.raises(CommandRefusedError, match="not_aligned"):
        await operator(client).request("hotspot.pulse")


async def test_the_coil_is_brought_to_its_place_from_anywhere(client: FakeClient) -> None:
    client.branches["placement"] = "unknown"
    await operator(client).place()
    assert client.asked == ["placement.locate", "placement.approach", "placement.confirm"]


async def test_failed_motion_is_repeated_up_to_a_limit(client: FakeClient) -> None:
    client.branches["placement"] = "standoff"
    client.answers["placement.confirm"] = [("failed", Reason(code="pose_missing_frames", text="Too few."))]
    await operator(client).place()
    assert client.asked == ["placement.confirm", "placement.confirm"]
    client.branches["placement"] = "standoff"
    client.answers["placement.confirm"] = [rejected("out_of_reach")] * 9
    with pytest.raises(CommandRefusedError, match="out_of_reach"):
        await operator(client).place()


async def test_a_latch_is_acknowledged(client: FakeClient) -> None:
    client.branches["placement"], client.latched = "held", True
    client.leads["placement.back_off"] = {"placement": "placed"}
    await operator(client).place()
    assert client.asked == ["robot.acknowledge", "placement.back_off"]


async def test_lasting_latch_is_reported_with_its_cause(client: FakeClient) -> None:
    client.branches["placement"], client.latched = "held", True
    client.answers["placement.back_off"] = [("failed", Reason(code="link_lost", text="The link is lost."))]
    client.answers["robot.acknowledge"] = [("accepted", None), rejected("invalid_in_state")]
    with pytest.raises(CommandRefusedError, match=r"back_off was failed in held: The link is lost\."):
        await operator(client).place()


async def test_stimulator_that_disarmed_by_itself_is_rearmed(client: FakeClient) -> None:
    client.answers["threshold.pulse"] = [rejected("not_armed"), ("accepted", None)]
    client.leads["stimulation.arm"] = {}  # it does not stay so
    await operator(client).fire("threshold.pulse")
    assert client.asked == ["stimulation.arm", "threshold.pulse"] * 2


async def test_a_pulse_of_unknown_outcome_is_not_given_again(client: FakeClient) -> None:
    client.answers["threshold.pulse"] = [("unknown", Reason(code="unknown_outcome", text="No answer."))]
    with pytest.raises(CommandRefusedError, match="unknown"):
        await operator(client).fire("threshold.pulse")
    assert client.asked.count("threshold.pulse") == 1


async def test_withdrawing_disarms_first(client: FakeClient) -> None:
    client.leads["placement.back_off"] = {"placement": "standoff"}
    await operator(client).withdraw()
    assert client.asked == ["stimulation.disarm", "placement.back_off", "placement.home"]


async def test_a_way_home_that_leads_past_the_body_begins_farther_away(client: FakeClient) -> None:
    client.branches["placement"] = "standoff"
    client.answers["placement.home"] = [rejected("distance_shrinks")]
    client.leads["toolplan.clear"] = {"placement": "held"}
    await operator(client).withdraw()
    assert client.asked[-3:] == ["toolplan.clear", "placement.back_off", "placement.home"]


async def test_a_coil_that_cannot_go_home_stays_clear_of_the_body(client: FakeClient) -> None:
    client.answers["placement.home"] = [rejected("distance_shrinks")] * 2
    await operator(client).withdraw()
    assert client.branches["placement"] == "retracted"


async def test_an_arm_that_gets_nowhere_is_given_up(client: FakeClient) -> None:
    client.branches["placement"] = "held"
    client.leads["placement.back_off"] = {"placement": "held"}
    with pytest.raises(CommandRefusedError, match="back_off"):
        await operator(client).place()


# What the journal says -----------------------------------------------------------------------------------------------


def row(operation: str, decision: str = "accepted", code: str = "", at: float = 0.0, **more: Any) -> JournalRow:
    branch, _, name = operation.partition(".")
    verdict = Verdict(
        id=f"{operation}{at}",
        branch=branch,
        operation=name,
        decision=cast(Any, decision),
        state="",
        sequence=1,
        reason=Reason(code=code, text=f"{code} at {at}") if code else None,
        result=more.pop("told", None),
    )
    return JournalRow(
        kind="outcome",
        wall=1.8e9 + at,
        monotonic=100.0 + at,
        boot_id="b",
        session_id="s",
        blueprint=TAG,
        source="bus:local:1",
        command_id=f"{operation}{at}",
        branch=branch,
        operation=name,
        verdict=verdict,
        result=more.pop("kept", None),
    )


def session_of(*rows: JournalRow) -> StimulationSession:
    stored = [StoredRow(sequence=number, row=each, previous_hash=b"", hash=b"") for number, each in enumerate(rows, 1)]
    return StimulationSession(SessionJournal(stored))


def test_refusals_of_one_kind_in_a_row_are_one() -> None:
    session = session_of(
        row("robot.connect"),
        row("hotspot.pulse", "rejected", "not_aligned", 1.0),
        row("hotspot.pulse", "rejected", "not_aligned", 2.0),
        row("hotspot.pulse", "failed", "pose_stale", 3.0),
        row("hotspot.pulse", "rejected", "not_aligned", 4.0),
    )
    found = session.refusals()
    assert [(each.code, each.decision, each.times) for each in found] == [
        ("not_aligned", "rejected", 2),
        ("pose_stale", "failed", 1),
        ("not_aligned", "rejected", 1),
    ]
    assert (found[0].onset, found[0].source, found[0].text) == (1.0, "bus:local", "not_aligned at 1.0")


def test_unfinished_command_at_the_end_of_the_record_is_unknown() -> None:
    begun = msgspec.structs.replace(row("threshold.pulse", at=7.0), kind="intent", verdict=None)
    finished = msgspec.structs.replace(row("robot.connect"), kind="intent", verdict=None)
    (found,) = session_of(finished, row("robot.connect"), begun).refusals()
    assert (found.operation, found.decision, found.onset) == ("threshold.pulse", "unknown", 7.0)


def test_only_accepted_pulses_were_given_as_far_as_is_known() -> None:
    response = {"pulse": 3, "intensity": 60.0, "coil": msgspec.to_builtins(HERE), "error_mm": 0.1, "error_deg": 0.2}
    problem = {"problem": "no_marker", "problem_text": "No marker."}
    kept = {"response": response | problem, "last_pulse": 104.5, "epoch": None, "hunt": None}
    session = session_of(
        row("robot.connect"),
        row("threshold.pulse", "unknown", "silent", 2.0),
        row("threshold.pulse", at=5.0, kept=kept),
    )
    (pulse,) = session.pulses()
    assert (pulse.pulse, pulse.phase, pulse.onset, pulse.problem, pulse.mep) == (3, "threshold", 4.5, "no_marker", None)
    assert session.hunt() is None
    assert session.refusals()[0].decision == "unknown"


def test_an_empty_journal_is_no_session() -> None:
    with pytest.raises(JournalError, match="empty"):
        session_of()


def test_true_threshold_is_higher_beside_the_hotspot() -> None:
    scene = SceneTruth(
        tracker_from_coil=HERE,
        tracker_from_body_ref=HERE,
        body_ref_from_image=HERE,
        image_from_hotspot=HERE,
        threshold=50.0,
    )
    beside = PoseMessage(position=(0.005, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    at, off = true_of(scene, HERE), true_of(scene, beside)
    assert at is not None
    assert off is not None
    assert at.threshold_here == pytest.approx(50.0)
    assert off.threshold_here is not None
    assert off.threshold_here > 51.0
    assert true_of(msgspec.structs.replace(scene, threshold=None), HERE) is None


# The folder ----------------------------------------------------------------------------------------------------------


def test_a_folder_in_use_is_refused(tmp_path: Path) -> None:
    make_folder(tmp_path / "new" / "session")
    make_folder(tmp_path / "new" / "session")
    (tmp_path / "new" / "session" / "other").touch()
    with pytest.raises(ConfigurationError, match="not empty"):
        make_folder(tmp_path / "new" / "session")


def test_a_journal_is_copied_while_it_is_written(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    writer = JournalWriter(tmp_path / "live.sqlite", durable=False)
    rows = [row("robot.connect"), row("hotspot.pulse", "rejected", "not_aligned", 1.0)]
    writer.write([(each, msgspec.msgpack.encode(each, order="sorted")) for each in rows])
    write_journal(tmp_path / "live.sqlite", folder)
    writer.close()
    with JournalReader(folder / JOURNAL) as reader:
        assert [stored.row for stored in reader.read()] == rows
    lines = (folder / ROWS).read_text().splitlines()
    assert [json.loads(line)["row"]["operation"] for line in lines] == ["connect", "pulse"]
    assert not list(folder.glob(f"{JOURNAL}-*"))  # what is beside a journal that is being written


def test_the_configuration_can_be_used_again(tmp_path: Path) -> None:
    asked = setup(seed=4, budget=30, overrides=("procedure.placement.frames=50",))
    write_configuration(asked.configuration, tmp_path)
    assert read_settings(tmp_path / "configuration.toml") == asked.configuration
    assert asked.configuration.procedure.stimulation.hotspot.max_pulses == 30
    assert asked.configuration.sim["seed"] == 4


@pytest.mark.parametrize("budget", [1, 5, 500])
def test_every_budget_can_be_kept(budget: int) -> None:
    assert setup(budget=budget).configuration.procedure.stimulation.hotspot.max_pulses == budget


def test_the_search_begins_on_the_right_side_of_the_head() -> None:
    centre, mesh = setup().centre(), setup().mesh
    assert isinstance(mesh, Mesh)
    assert 0.04 < centre.position[0] < 0.07
    assert abs(centre.position[1]) < 0.03


def test_a_grid_has_no_budget() -> None:
    outcome = CliRunner().invoke(main, ["session", "ratms-threshold", "--method", "grid", "--budget", "5"])
    assert outcome.exit_code == 2
    assert "--budget" in outcome.stderr


def test_the_command_refuses_a_folder_in_use(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    outcome = CliRunner().invoke(main, ["session", "ratms-threshold", "--out", str(tmp_path)])
    assert outcome.exit_code == 4
    assert "not empty" in outcome.stderr


# All of it -----------------------------------------------------------------------------------------------------------


def check_sums(folder: Path) -> None:
    lines = [line.split("  ", 1) for line in (folder / SUMS).read_text().splitlines()]
    listed = {name: digest for digest, name in lines}
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert set(listed) == files - {SUMS}
    assert all(hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest for name, digest in listed.items())


@pytest.mark.timeout(300)  # of a machine that does much else
@pytest.mark.nightly
async def test_a_session_from_landmarks_to_threshold(tmp_path: Path) -> None:
    asked, told = setup(seed=4, budget=3, overrides=QUICK), []
    report = await run_threshold_session(asked, tmp_path, lambda doing, _done, _total: told.append(doing))
    assert report.ended == ""
    assert report.threshold is not None
    assert report.hotspot_pulses >= 3
    assert report.threshold_error is not None
    assert abs(report.threshold_error) < 40.0  # of a hunt that ends early
    record = read_record(tmp_path / JOURNAL, asked, None, "")
    assert isinstance(record, SessionRecord)
    assert [pulse.pulse for pulse in record.pulses] == list(range(1, report.pulses + 1))
    assert all(pulse.error_mm <= 1.5 and pulse.intensity <= 90.0 for pulse in record.pulses)
    page = (tmp_path / "report.html").read_text()
    assert "Simulated." in page
    assert "Incomplete" not in page
    assert f"{report.threshold:g}" in page
    check_sums(tmp_path)
    with sqlite3.connect(tmp_path / JOURNAL) as journal:
        assert journal.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert told[-1] == "done"
    assert any(doing.startswith("hunting") for doing in told)


@pytest.mark.slow
@pytest.mark.nightly
async def test_an_interrupted_session_keeps_what_was_recorded(tmp_path: Path) -> None:
    asked = setup(seed=4, budget=3, overrides=QUICK)
    task = asyncio.current_task()
    assert task is not None

    def interrupt(doing: str, _done: int, _total: int) -> None:
        if doing.endswith("pulse 2"):
            task.cancel()

    report = await run_threshold_session(asked, tmp_path, interrupt)
    assert report.ended == INTERRUPTED
    assert report.pulses >= 1
    assert report.threshold is None
    assert "Incomplete." in (tmp_path / "report.html").read_text()
    check_sums(tmp_path)


@pytest.mark.nightly
async def test_a_muscle_that_is_never_at_rest_ends_the_session(tmp_path: Path) -> None:
    asked = setup(seed=4, budget=3, overrides=(*QUICK, "sim.muscle.preactivation_uv=40"))
    report = await run_threshold_session(asked, tmp_path, lambda *_: None)
    assert report.ended.startswith("8 pulses in a row do not count. The last one: ")
    assert (report.pulses, report.hotspot_pulses, report.threshold) == (8, 0, None)
    record = read_record(tmp_path / JOURNAL, asked, None, report.ended)
    assert {pulse.problem for pulse in record.pulses} <= {"preactivated", "artefact"}
    assert all(pulse.problem_text for pulse in record.pulses)


def test_asking_for_help_loads_no_experiment() -> None:
    code = "import sys, pcmrs_lab.cli.session; sys.exit('pcmrs_lab.experiment.threshold_session' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
