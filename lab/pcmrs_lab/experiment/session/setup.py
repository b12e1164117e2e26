"""Setup of a session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from pcmrs.errors import ConfigurationError
from pcmrs.formats.mesh import Mesh
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.settings import Settings, read_settings
from pcmrs.testing.plan import Plan
from pcmrs.tms.scalp import hand_area
from pcmrs.tms.settings import HotspotMethod, HotspotSettings, ThresholdMethod
from pcmrs.workflows.surface import read_surface
from pcmrs.workflows.toolplan import ToolPose
from pcmrs_lab.experiment.setup import at_rate

WORKFLOW = "ratms_threshold"
EXPECTED = 15
"""Approximate number of pulses to find an intensity, and of those to find the threshold."""
OFF_TIME, POSE_AGE, SPEED_TIME = 0.1, 0.2, 0.3
"""Default delay of the alignment, and the workflow's limits for the age of poses and the window of the speed, s."""


@dataclass(frozen=True)
class SessionSetup:
    """One session on a simulated cell.

    Attributes:
        plan: Landmarks and poses; the first pose is at the vertex of the head.
        seed: Seed of the simulated subject and of all errors.
        rate: Seconds of the simulated cell per second of the machine.
        method: Method of the hot-spot search.
        threshold: Method of the threshold estimation.
        budget: Largest number of pulses of an adaptive search; None for the configured one.
        ceiling: Highest allowed intensity, percent of the maximum stimulator output.
        overrides: Further settings of the daemon, ``key=value`` each.
        configuration: Resulting settings of the daemon.
        mesh: Surface of the head in the image, m.

    Raises:
        ConfigurationError: A setting cannot be used, or the plan has no pose.
    """

    plan: Plan
    seed: int = 1
    rate: float = 5.0
    method: HotspotMethod = "adaptive"
    threshold: ThresholdMethod = "ml"
    budget: int | None = None
    ceiling: float = 90.0
    overrides: Sequence[str] = ()
    configuration: Settings = field(init=False)
    mesh: Mesh = field(init=False)

    def __post_init__(self) -> None:
        configuration = read_settings(None, self.settings())
        mesh = read_surface(configuration.procedure)
        if mesh is None or not self.plan.poses:
            raise ConfigurationError(
                "A session needs a surface of the head, and a plan whose first pose is its vertex."
            )
        object.__setattr__(self, "configuration", configuration)
        object.__setattr__(self, "mesh", mesh)

    def settings(self) -> list[str]:
        """Return the settings that differ from the default configuration, ``key=value`` each."""
        own = [f"workflow={WORKFLOW}", f"sim.seed={self.seed}", *at_rate(self.rate), *_late(self.rate)]
        if self.budget is not None:
            hotspot = "procedure.stimulation.hotspot"
            least = min(self.budget, HotspotSettings().min_pulses)
            own += [f"{hotspot}.max_pulses={self.budget}", f"{hotspot}.min_pulses={least}"]
        return [*own, *self.overrides]

    @property
    def interval(self) -> float:
        """Shortest time between two pulses, s of the cell."""
        return self.configuration.procedure.stimulation.intervals.least

    @property
    def expected_pulses(self) -> int:
        """Approximate number of pulses of the session."""
        hotspot = self.configuration.procedure.stimulation.hotspot
        places = 3 * hotspot.rings * (hotspot.rings + 1) + 1
        return 2 * EXPECTED + (places if self.method == "grid" else hotspot.max_pulses)

    def centre(self) -> ToolPose:
        """Return the pose at which the search starts: over the hand area, found on the surface from the vertex."""
        closest = TriangleSurface(self.mesh.vertices, self.mesh.faces).closest
        pose = hand_area(closest, self.plan.poses[0].position)
        w, x, y, z = pose.quat_wxyz.tolist()
        px, py, pz = pose.translation.tolist()
        return ToolPose((px, py, pz), (x, y, z, w))


def _late(rate: float) -> list[str]:
    """Return the settings for late poses: the delay of the bus is `rate` times as long in the time of the cell."""
    if rate == 1.0:
        return []
    stimulation = "procedure.stimulation"
    return [
        f"procedure.alignment.off_time={OFF_TIME * rate:g}",
        f"procedure.following.longest_gap={POSE_AGE}",
        f"{stimulation}.pose_age={POSE_AGE}",
        f"{stimulation}.speed_time={SPEED_TIME}",
    ]
