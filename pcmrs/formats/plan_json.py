"""Landmarks of PCMRS's own plan files, as ``pcmrs experiment`` and a script planner read them."""

from __future__ import annotations

from pathlib import Path

import msgspec

from pcmrs.formats.grid import Named, Role
from pcmrs.formats.reading import read_text, refuse


class _Landmark(msgspec.Struct, frozen=True):
    name: str
    position: tuple[float, float, float]


class _Plan(msgspec.Struct, frozen=True):
    landmarks: tuple[_Landmark, ...]


def read_plan_landmarks(path: Path) -> tuple[list[Named], Role]:
    """The planned landmarks in the image, RAS, m. Raises `FileFormatError`."""
    try:
        plan = msgspec.json.decode(read_text(path), type=_Plan)
    except (msgspec.MsgspecError, RecursionError) as error:
        refuse(path, f"is no plan: {error}.")
    return [(landmark.name, landmark.position) for landmark in plan.landmarks], "planned"
