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
from pcmrs_lab.experiment.private import ExperimentBench, private_bench
from pcmrs_lab.experiment.session.runner import SessionRunner
from pcmrs_lab.experiment.session.setup import SessionSetup
from pcmrs_lab.experiment.setup import ShowProgress
from pcmrs_sim.tms.recruitment import Recruitment
from pcmrs_sim.tms.subject import Subject

LIBRARIES = ("pcmrs", "numpy", "scipy", "scikit-learn", "mujoco", "eclipse-zenoh")
INTERRUPTED = "it was interrupted."


class SessionSummary(msgspec.Struct, frozen=True):
    """Summary of a session.

    Attributes:
        folder: Folder of all its files.
        ended: Reason why it ended early; empty if it is complete.
        hotspot_mm: Estimated hot-spot in the image, mm; None if none was found.
        hotspot_uncertainty_mm: Uncertainty of the hot-spot, rms.
        threshold: Threshold, percent of the maximum stimulator output; None if none was found.
        threshold_low: Lower end of the 95 % interval; None if the method has none.
        threshold_high: Upper end of the 95 % interval; None if the method has none.
        hotspot_error_mm: Distance of the hot-spot from the true one; None without a simulation.
        threshold_error: Error of the threshold, percent of the true one at the same pose.
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
    """Run a session on its own daemon and write its results, also if it ends early.

    Args:
        setup: Setup of the session.
        folder: Folder of the results. It must be empty or new.
        progress: Callback for the present step, the number of pulses, and their expected total.

    Returns:
        Summary of the session.

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
        ended = await _run_to_end(bench, setup, progress)
        write_journal(bench.journal.path, folder)
    progress("writing the report", 1, 1)
    record = read_record(folder / JOURNAL, setup, truth, ended)
    write_results(record, setup.mesh, folder)
    write_sums(folder)
    progress("done", 1, 1)
    return report_of(record, folder)


async def _run_to_end(bench: ExperimentBench, setup: SessionSetup, progress: ShowProgress) -> str:
    """Run the session; return why it ended early, or an empty text. If it did, stop the cell."""
    try:
        await SessionRunner(bench, setup, progress).run()
    except asyncio.CancelledError:
        task = asyncio.current_task()
        if task is not None:
            task.uncancel()  # writing the results takes only a moment
        ended = INTERRUPTED
    except PcmrsError as error:
        ended = error.text
    else:
        return ""
    with suppress(PcmrsError):  # the daemon may have ended by the same Ctrl-C
        await bench.client.stop()
    return ended


def read_record(journal: Path, setup: SessionSetup, truth: SceneTruth | None, ended: str) -> SessionRecord:
    """Return the data of a session from its journal.

    Args:
        journal: Journal file.
        setup: Setup of the session.
        truth: Truth of the simulation, for the report alone.
        ended: Reason why the session ended early; empty if it is complete.

    Raises:
        JournalError: The journal cannot be read, or is empty.
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
    """Return the truth about the simulated subject; None if the scene has no subject.

    Args:
        scene: Truth of the simulation.
        image_from_coil: Pose at which the threshold was estimated; None if it was not.
    """
    if scene.image_from_hotspot is None or scene.threshold is None:
        return None
    here = None
    if image_from_coil is not None:
        subject = Subject(Recruitment(scene.threshold), as_transform(scene.image_from_hotspot))
        here = scene.threshold / subject.effective(as_transform(image_from_coil), 1.0)
    return Truth(hotspot=scene.image_from_hotspot, threshold=scene.threshold, threshold_here=here)


def report_of(record: SessionRecord, folder: Path) -> SessionSummary:
    """Return the summary of a session.

    Args:
        record: Data of the session.
        folder: Folder of its files.
    """
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
    """Return the position of a pose, mm."""
    x, y, z = pose.position
    return 1e3 * x, 1e3 * y, 1e3 * z
