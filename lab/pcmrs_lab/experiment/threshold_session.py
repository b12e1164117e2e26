"""A whole session on a simulated cell, from landmarks to the motor threshold, and its folder."""

from __future__ import annotations

import asyncio
import platform
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

import msgspec

from pcmrs.analysis.session import SessionRecord, Truth
from pcmrs.errors import PcmrsError
from pcmrs.messages import PoseMessage, SceneTruth
from pcmrs.report.session_folder import (
    JOURNAL,
    make_folder,
    write_configuration,
    write_journal,
    write_results,
    write_sums,
)
from pcmrs.report.session_journal import SessionJournal
from pcmrs.report.stimulation.facts import facts_of
from pcmrs.report.stimulation.reading import StimulationSession
from pcmrs.tms.scalp import as_transform
from pcmrs_lab.experiment.private import Bench, private_bench
from pcmrs_lab.experiment.session.runner import SessionRunner
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.setup import ShowProgress
from pcmrs_sim.tms.recruitment import Recruitment
from pcmrs_sim.tms.subject import Subject

LIBRARIES = ("pcmrs", "numpy", "scipy", "scikit-learn", "mujoco", "eclipse-zenoh")
INTERRUPTED = "it was interrupted."


class SessionSummary(msgspec.Struct, frozen=True):
    """What a session came to.

    Attributes:
        folder: Where everything is.
        ended: Why it ended early; empty where it is complete.
        hotspot_mm: Estimate in the image, mm; None where none was found.
        hotspot_uncertainty_mm: Of it, rms.
        threshold: Percent of the maximum stimulator output; None where none was found.
        threshold_low: Lower end of the interval of 95 %; None where the method states none.
        threshold_high: Its upper end.
        hotspot_error_mm: Against the truth of the simulation.
        threshold_error: The same, percent of the true threshold where it was hunted.
    """

    session: str
    workflow: str
    simulated: bool
    seed: int
    rate: float
    folder: str
    ended: str
    residual_mm: float | None
    placements: int
    placement_error_mm: float | None
    pulses: int
    hotspot_pulses: int
    threshold_pulses: int
    hotspot_mm: tuple[float, float, float] | None
    hotspot_uncertainty_mm: float | None
    threshold: float | None
    threshold_low: float | None
    threshold_high: float | None
    hotspot_error_mm: float | None
    threshold_error: float | None


async def run_threshold_session(setup: SessionSetup, folder: Path, progress: ShowProgress) -> SessionSummary:
    """Runs a session through a daemon of its own; what was recorded is written, however it ends.

    Args:
        setup: What is to be done.
        folder: For the results; empty, or not there yet.
        progress: Told about every step.

    Raises:
        ConfigurationError: The folder is in use.
        DeviceError: The daemon did not start.
        JournalError: Its journal cannot be copied.
    """
    make_folder(folder)
    write_configuration(setup.configuration, folder)
    progress("starting the daemon", 0, setup.expected_pulses)
    async with private_bench(setup.settings()) as bench:
        truth = await bench.scene.truth()
        ended = await _carried_out(bench, setup, progress)
        write_journal(bench.journal.path, folder)
    progress("writing the report", 1, 1)
    record = read_record(folder / JOURNAL, setup, truth, ended)
    write_results(record, setup.mesh, folder)
    write_sums(folder)
    progress("done", 1, 1)
    return report_of(record, folder)


async def _carried_out(bench: Bench, setup: SessionSetup, progress: ShowProgress) -> str:
    """Runs the course; why it ended early, or nothing. All is stopped then."""
    try:
        await SessionRunner(bench, setup, progress).run()
    except asyncio.CancelledError:
        task = asyncio.current_task()
        if task is not None:
            task.uncancel()  # what follows takes a moment, and ends by itself
        ended = INTERRUPTED
    except PcmrsError as error:
        ended = error.text
    else:
        return ""
    with suppress(PcmrsError):  # the daemon may have ended with us
        await bench.client.stop()
    return ended


def read_record(journal: Path, setup: SessionSetup, truth: SceneTruth | None, ended: str) -> SessionRecord:
    """What a session's journal says of it.

    Args:
        journal: The file.
        setup: What was asked for.
        truth: Of the simulation, for the report alone.
        ended: Why it ended early.

    Raises:
        JournalError: The journal cannot be read, or holds nothing.
    """
    session = StimulationSession(SessionJournal.read(journal))
    procedure, hotspot = setup.configuration.procedure, session.hotspot()
    return SessionRecord(
        subject=procedure.patient,
        seed=setup.seed,
        rate=setup.rate,
        begun=session.started_at,
        duration=session.duration,
        workflow=session.workflow,
        settings=tuple(setup.settings()),
        versions={"Python": platform.python_version(), **{name: version(name) for name in LIBRARIES}},
        mep_settings=procedure.stimulation.mep,
        ended=ended,
        ceiling=session.ceiling(),
        registration=session.registration(),
        placements=session.placements(),
        pulses=session.pulses(),
        refusals=session.refusals(),
        search=session.search(),
        hotspot=hotspot,
        hunt=session.hunt(),
        threshold=session.threshold(),
        truth=None if truth is None else true_of(truth, None if hotspot is None else hotspot.image_from_coil),
    )


def true_of(scene: SceneTruth, image_from_coil: PoseMessage | None) -> Truth | None:
    """What the simulation knows of its subject; None where there is nobody to stimulate.

    Args:
        scene: Its truth.
        image_from_coil: Where the threshold was hunted; None where it was not.
    """
    if scene.image_from_hotspot is None or scene.threshold is None:
        return None
    here = None
    if image_from_coil is not None:
        subject = Subject(Recruitment(scene.threshold), as_transform(scene.image_from_hotspot))
        here = scene.threshold / subject.effective(as_transform(image_from_coil), 1.0)
    return Truth(hotspot=scene.image_from_hotspot, threshold=scene.threshold, threshold_here=here)


def report_of(record: SessionRecord, folder: Path) -> SessionSummary:
    """The few numbers of a session."""
    facts, found, threshold = facts_of(record), record.hotspot, record.threshold
    return SessionSummary(
        session="ratms-threshold",
        workflow=record.workflow.id,
        simulated=record.simulated,
        seed=record.seed or 0,
        rate=record.rate,
        folder=str(folder),
        ended=record.ended,
        residual_mm=None if record.registration is None else record.registration.residual_mm,
        placements=len(record.placements),
        placement_error_mm=None if facts.placement_mm is None else facts.placement_mm.mean,
        pulses=facts.pulses,
        hotspot_pulses=len(record.of_phase("hotspot")),
        threshold_pulses=len(record.of_phase("threshold")),
        hotspot_mm=None if found is None else as_point_mm(found.image_from_coil),
        hotspot_uncertainty_mm=None if found is None else 1e3 * found.uncertainty,
        threshold=None if threshold is None else threshold.threshold,
        threshold_low=None if threshold is None else threshold.low,
        threshold_high=None if threshold is None else threshold.high,
        hotspot_error_mm=facts.hotspot_error_mm,
        threshold_error=facts.threshold_error,
    )


def as_point_mm(pose: PoseMessage) -> tuple[float, float, float]:
    """Where a pose is, mm."""
    x, y, z = pose.position
    return 1e3 * x, 1e3 * y, 1e3 * z
