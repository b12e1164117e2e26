"""One sample of a pose log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    # Only for annotations: a planner shares this package's grammar and must not load NumPy for it.
    from pcmrs.spatial import Transform


@dataclass(frozen=True, eq=False, slots=True)
class TrackedPoses:
    """Measured poses of one sample, as the lab's software logs them; its body is the patient's image.

    Attributes:
        image_from_tool: Row ``body_tool``: contact point of the tool in the image, as the stream of poses has it.
        tracker_from_image: Row ``pol_body``: marker body on the patient, times the registration.
        tracker_from_tool: Row ``pol_tool``: contact point of the tool in the tracker.
    """

    image_from_tool: Transform
    tracker_from_image: Transform
    tracker_from_tool: Transform
