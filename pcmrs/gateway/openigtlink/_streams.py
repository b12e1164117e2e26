"""Messages to all peers: poses at a steady rate, the state at each change, the status then and every second.

Poses have the names of PLUS and SlicerIGT: ``XToY`` maps X to Y. Image is the frame of the image, RAS in Slicer's
scene; Tracker, Base (of the robot) and Reference are further frames.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

from pyigtl.messages import TransformMessage

from pcmrs.clock import Clock
from pcmrs.devices.plus.messages import TrackingDataMessage, matrix_mm, text_message
from pcmrs.gateway._adapter import Core
from pcmrs.gateway.openigtlink._peer import Peer
from pcmrs.messages import Snapshot
from pcmrs.spatial import Transform

TOOLS = "PcmrsTools"
NAMES = {"coil": "Coil", "pointer": "Pointer", "body_ref": "Reference"}
STATUS_PERIOD = 1.0
"""Limit between two status messages on a connection, s; they also detect a dead connection."""


class Broadcaster:
    """Sender of new poses, states and statuses to all peers.

    Args:
        core: The daemon.
        clock: The machine's clock.
        together: Send the poses as one TDATA message instead of a TRANSFORM each.
    """

    def __init__(self, core: Core, clock: Clock, *, together: bool) -> None:
        self._core = core
        self._clock = clock
        self._together = together
        self._status_due = 0.0

    def send(self, peers: Collection[Peer]) -> None:
        """Send what is new; a peer that has connected since the last call gets everything."""
        snapshot, now, found = self._core.snapshot(), self._clock.monotonic(), self._poses()
        texts = _texts(snapshot)
        state = self._packed(texts) if any(peer.shown != texts for peer in peers) else []
        due = now >= self._status_due
        if due:
            self._status_due = now + STATUS_PERIOD
        for peer in peers:
            changed, peer.shown = peer.shown != texts, texts
            for data in state if changed else []:
                peer.outbox.put(data)
            if changed or due:
                peer.send_status(snapshot.latched)
            for name, data in found.items():
                peer.outbox.put_pose(name, data)

    def _packed(self, texts: Mapping[str, str]) -> list[bytes]:
        return [text_message(text, **self._header(name)).pack() for name, text in texts.items()]

    def _poses(self) -> dict[str, bytes]:
        """Packed messages of the known poses, by name."""
        matrices = {name: matrix_mm(pose) for name, pose in poses(self._core).items()}
        if not self._together:
            return {name: TransformMessage(matrix, **self._header(name)).pack() for name, matrix in matrices.items()}
        return {TOOLS: TrackingDataMessage(matrices, **self._header(TOOLS)).pack()} if matrices else {}

    def _header(self, name: str) -> dict[str, Any]:
        return {"device_name": name, "timestamp": self._clock.wall()}


def _texts(snapshot: Snapshot) -> dict[str, str]:
    return {"PcmrsState": state_json(snapshot), "PcmrsLine": state_line(snapshot)}


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


def state_json(snapshot: Snapshot) -> str:
    """Return the JSON of ``PcmrsState``: sequence, branches, flags, running, prompt, latched, plan and registration."""
    return json.dumps(
        {
            "sequence": snapshot.sequence,
            "branches": snapshot.branches,
            "flags": snapshot.flags,
            "running": [f"{each.branch}.{each.operation}" for each in snapshot.running],
            "prompt": prompt_of(snapshot),
            "latched": snapshot.latched,
            "plan": snapshot.plan,
            "registration": snapshot.registration,
        }
    )


def prompt_of(snapshot: Snapshot) -> str:
    """Return what a person is asked to touch now; empty for nothing."""
    return next((each.prompt.text for each in snapshot.running if each.prompt is not None), "")


def state_line(snapshot: Snapshot) -> str:
    """Return one short line for people."""
    parts = [f"{branch} {state}" for branch, state in snapshot.branches.items()]
    parts += [f"running {each.branch}.{each.operation}" for each in snapshot.running]
    return ("LATCHED, " if snapshot.latched else "") + ", ".join(parts)
