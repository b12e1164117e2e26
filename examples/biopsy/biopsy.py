"""Checks and steps of the needle biopsy. Lengths in m; the digitizing pointer stands for the tracked needle."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from pcmrs.dispatcher import Registry, Run
from pcmrs.errors import RefusalError
from pcmrs.messages import LandmarkPrompt
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, Point, as_point, as_transform


class NeedlePath(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `plan_path`, in the image."""

    entry: Point
    target: Point


class Data(PlacementData, frozen=True, kw_only=True):
    """Data of a biopsy besides landmarks and registration."""

    path: NeedlePath | None = None
    tip: Point | None = None


def path_fits_needle(run: Run[Cell, Data]) -> None:
    """A check is pure: it refuses by raising, and then nothing has happened."""
    length = math.dist(run.payload.entry, run.payload.target)
    limit = run.cell.settings.limits["needle_length_mm"] / 1000.0
    if not length <= limit:
        text = f"The path is {length * 1000:.0f} mm long; the needle has {limit * 1000:.0f} mm. Choose another entry."
        raise RefusalError("path_too_long", text, length=length, limit=limit)


def keep_path(run: Run[Cell, Data]) -> None:
    """A step keeps what it changes; it is committed with the new state, or not at all."""
    run.keep(path=run.payload, tip=None)


async def bring_tip_to_target(run: Run[Cell, Data]) -> None:
    """A world step waits for devices: it prompts for the needle at the target, then measures its tip in the image."""
    cell, path, registered = run.cell, run.data.path, run.data.registered
    if path is None or registered is None:
        raise RefusalError("not_ready", "Plan a path and register first.")
    prompt = LandmarkPrompt(index=len(run.data.landmarks), name="biopsy target", position_in_image=path.target)
    await cell.pointer.touch(prompt)
    frames = await cell.poses.collect(["body_ref", "pointer"], cell.settings.registration.samples, timeout=5.0)
    image_from_body_ref = as_transform(registered.body_ref_from_image).inverse()
    tip = cell.pointer_from_tip.translation
    tips = [image_from_body_ref @ (frame["body_ref"].inverse() @ (frame["pointer"] @ tip)) for frame in frames]
    run.keep(tip=as_point(np.mean(tips, axis=0)))


def tip_at_target(run: Run[Cell, Data]) -> None:
    """A refusal in a step is a failure: the operation ends where the blueprint's `on_failure` says."""
    path, tip = run.data.path, run.data.tip
    if path is None or tip is None:
        raise RefusalError("not_measured", "The tip has not been measured.")
    distance, limit = math.dist(tip, path.target), run.cell.settings.limits["tip_tolerance_mm"] / 1000.0
    run.result |= {"tip": tip, "distance": distance, "limit": limit}
    if not distance <= limit:
        text = f"The tip is {distance * 1000:.1f} mm from the target; the limit is {limit * 1000:.1f} mm. Withdraw."
        raise RefusalError("target_missed", text, distance=distance, limit=limit)


def register(registry: Registry[Cell, PlacementData]) -> None:
    """Register the functions under their own names, which biopsy.toml uses. The daemon calls this."""
    registry.payload("needle_path", NeedlePath)
    registry.check(path_fits_needle)
    registry.step(keep_path)
    registry.world_step(bring_tip_to_target)
    registry.step(tip_at_target)
