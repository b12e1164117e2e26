"""Records of sessions that never were: pulses on a simulated subject, made without a daemon."""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np

from pcmrs.analysis.session import (
    Phase,
    PlacementRecord,
    PulseRecord,
    RefusalRecord,
    RegistrationRecord,
    SessionRecord,
    Truth,
)
from pcmrs.formats.mesh import Mesh, read_mesh
from pcmrs.messages import BlueprintTag, Epoch
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.mep import Mep, judge_mep
from pcmrs.tms.scalp import as_message, as_transform, hand_area, turned
from pcmrs.tms.settings import HotspotSettings, MepSettings, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs.workflows.settings import BodySettings
from pcmrs.workflows.surface import find_surface
from pcmrs_sim.tms.recruitment import Recruitment
from pcmrs_sim.tms.subject import Subject

RATE_HZ = 4000.0
SETTINGS = MepSettings()
SEARCH_PERCENT = 75.0


def epoch(pulse: int, volts: float) -> Epoch:
    times = -0.12 + np.arange(900) / RATE_HZ
    shape = np.where((times > 0.022) & (times < 0.032), np.sin((times - 0.022) * 2.0 * np.pi / 0.010), 0.0)
    noise = np.random.default_rng(pulse).normal(0.0, 2e-6, len(times))
    return Epoch(
        pulse=pulse, muscle="FDI", rate_hz=RATE_HZ, start=-0.12, samples=(0.5 * volts * shape + noise).tolist()
    )


@cache
def mesh() -> Mesh:
    return read_mesh(find_surface(BodySettings(surface="head_phantom.ply")), "m", "RAS")


@cache
def sparse_mesh() -> Mesh:
    """A tenth of the triangles, which are drawn in a tenth of the time."""
    return Mesh(mesh().vertices, mesh().faces[::10])


class Maker:
    """Gives pulses and keeps them."""

    def __init__(self) -> None:
        closest = TriangleSurface(mesh().vertices, mesh().faces).closest
        self.centre = hand_area(closest, mesh().vertices[np.argmax(mesh().vertices[:, 2])])
        self.subject = Subject(Recruitment(50.0), turned(self.centre, 0.2))
        self.search = HotspotSearch.begin(
            HotspotSettings(method="grid", rings=1, heading_step_deg=45.0), closest, self.centre
        )
        self.rng = np.random.default_rng(1)
        self.pulses: list[PulseRecord] = []

    def pulse(self, phase: Phase, percent: float, coil: Transform) -> Mep:
        number = len(self.pulses) + 1
        signal = epoch(number, self.subject.response(coil, percent, self.rng))
        mep = judge_mep(signal, SETTINGS)
        self.pulses.append(
            PulseRecord(
                pulse=number,
                phase=phase,
                onset=5.0 * number,
                wall=1.8e9 + number,
                intensity=percent,
                coil=as_message(coil),
                error_mm=0.123,
                error_deg=0.045,
                mep=mep,
                epoch=signal,
            )
        )
        return mep


@cache
def record() -> SessionRecord:
    """A complete one; its second pulse found a tense muscle, its third was not measured."""
    maker = Maker()
    for percent in (40.0, 40.0, 40.0, SEARCH_PERCENT):
        maker.pulse("intensity", percent, maker.centre)
    maker.pulses[1] = msgspec.structs.replace(
        maker.pulses[1], problem="preactivated", problem_text="The muscle was active before the pulse."
    )
    maker.pulses[2] = msgspec.structs.replace(
        maker.pulses[2], mep=None, epoch=None, problem="no_marker", problem_text="No marker of pulse 3 was seen."
    )
    search = maker.search
    while not search.finished:
        pose = search.next()
        mep = maker.pulse("hotspot", SEARCH_PERCENT, as_transform(pose))
        search = search.after(pose, mep.peak_to_peak)
    hunt = MotorThresholdEstimator.begin(ThresholdSettings())
    while not hunt.finished:
        mep = maker.pulse("threshold", hunt.next_intensity(), as_transform(search.estimate.image_from_coil))
        hunt = hunt.after(hunt.next_intensity(), mep.peak_to_peak >= 50e-6, mep.peak_to_peak)
    hotspot = search.estimate
    true = as_message(maker.subject.image_from_hotspot)
    planned = as_message(maker.centre)
    placement = PlacementRecord(
        onset=3.0, error_mm=0.031, error_deg=0.012, planned=planned, measured=planned, tre_mm=2.57
    )
    return SessionRecord(
        subject="phantom",
        seed=7,
        rate=5.0,
        begun=1.8e9,
        duration=725.0,
        workflow=BlueprintTag(id="ratms_threshold", version="1.0.0", hash="ab" * 32),
        settings=("cell.rate=5", "sim.seed=7"),
        versions={"pcmrs": "9.8.7", "numpy": "2.3.4"},
        mep_settings=SETTINGS,
        ceiling=(90.0, "Dr Hand"),
        registration=RegistrationRecord(
            landmarks={"nasion": (0.004, 0.086, 0.040), "left_tragus": (-0.079, -0.008, 0.019)},
            distances_mm=(1.11, 2.22),
            residual_mm=1.84,
            rms_mm=1.91,
            limit_mm=4.0,
            tre_mm=1.32,
            tre_at="centroid",
        ),
        placements=(placement, msgspec.structs.replace(placement, onset=9.0, error_mm=0.053)),
        pulses=tuple(maker.pulses),
        refusals=(
            RefusalRecord(
                onset=61.0,
                operation="hotspot.pulse",
                source="bus:local",
                decision="rejected",
                code="not_aligned",
                text="The coil is 2 mm < 3 mm & moving.",
                times=4,
            ),
        ),
        search=search,
        hotspot=hotspot,
        hunt=hunt,
        threshold=hunt.estimate,
        truth=Truth(hotspot=true, threshold=50.0, threshold_here=51.5),
    )


def nothing() -> SessionRecord:
    """One that ended before anything was done."""
    full = record()
    return SessionRecord(
        subject=full.subject,
        seed=full.seed,
        rate=1.0,
        begun=full.begun,
        duration=0.0,
        workflow=full.workflow,
        settings=(),
        versions={},
        mep_settings=SETTINGS,
        ended="it was interrupted.",
    )
