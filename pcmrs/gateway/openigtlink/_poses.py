"""Poses for Slicer, under the names of PLUS and SlicerIGT: ``XToY`` maps X to Y.

Image is the frame of the image, RAS in Slicer's scene; Tracker, Base (of the robot) and Reference are further frames.
"""

from __future__ import annotations

from pcmrs.gateway._adapter import Core
from pcmrs.spatial import Transform

NAMES = {"coil": "Coil", "pointer": "Pointer", "body_ref": "Reference"}


def poses(core: Core) -> dict[str, Transform]:
    """Return name to ``y_from_x``, m, of all poses that are known now."""
    seen = {NAMES[body]: pose for body, pose in core.seen().items() if body in NAMES}
    found = {f"{name}ToTracker": pose for name, pose in seen.items()}
    reference, body_ref_from_image = seen.get("Reference"), core.registration()
    if reference is not None and body_ref_from_image is not None:
        image_from_tracker = (reference @ body_ref_from_image).inverse()
        found |= {f"{name}ToImage": image_from_tracker @ pose for name, pose in seen.items()}
        tip = core.tip_in_image()
        if tip is not None and "Pointer" in seen:
            found["PointerTipToImage"] = Transform(found["PointerToImage"].rotation, tip)
    found |= _known("TargetToImage", core.target_in_image())
    return found | _known("FlangeToBase", core.flange_pose())


def _known(name: str, pose: Transform | None) -> dict[str, Transform]:
    return {} if pose is None else {name: pose}
