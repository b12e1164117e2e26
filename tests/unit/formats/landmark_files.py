"""Landmark files of every kind with the same three points."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import FileFormatError
from pcmrs.formats.landmarks import read_landmarks

POINTS = np.array([(-0.1615691632, 0.0274949, 0.003382), (0.01, -1e-05, 0.1), (0.0, 0.0949, -0.0005)])
NAMES = ("p0", "p1", "p2")


def lab(key: str = "PLANNED", names: tuple[str, ...] = NAMES, num: int = 3) -> str:
    rows = ",\n".join(
        f"    {name}: {{x: {x!r}, y: {y!r}, z: {z!r}}}" for name, (x, y, z) in zip(names, POINTS.tolist(), strict=False)
    )
    return f"NUM: {num}\n\n{key}: # in m\n\n  {{\n{rows}\n  }}\n \nTIMESTAMP: 20240102_030405AM\n"


def markups(space: str | None = "LPS", unit: str | None = "mm", **point: Any) -> dict[str, Any]:
    scale = {"m": 1.0, "um": 1e6}.get(unit or "mm", 1e3)
    signs = (1, 1, 1) if space == "RAS" else (-1, -1, 1)
    points = [
        {"id": str(index), "label": name, "position": (place * signs * scale).tolist(), "positionStatus": "defined"}
        for index, (name, place) in enumerate(zip(NAMES, POINTS, strict=True))
    ]
    points[0] |= point
    said = {"coordinateSystem": space, "coordinateUnits": unit}
    stated = {key: value for key, value in said.items() if value is not None}
    return {"@schema": "markups", "markups": [{"type": "Fiducial", **stated, "controlPoints": points}]}


def fcsv(space: str = "LPS") -> str:
    signs = (1, 1, 1) if space in ("RAS", "0") else (-1, -1, 1)
    rows = [
        f"{index},{x},{y},{z},0,0,0,1,1,1,0,{name},,"
        for index, (name, (x, y, z)) in enumerate(zip(NAMES, (POINTS * signs * 1e3).tolist(), strict=True))
    ]
    header = ["# Markups fiducial file version = 4.13", f"# CoordinateSystem = {space}"]
    columns = "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"
    return "\n".join([*header, columns, *rows]) + "\n"


def csv_text(header: str = "name,x_mm,y_mm,z_mm", scale: float = 1e3) -> str:
    rows = (f"{name},{x!r},{y!r},{z!r}" for name, (x, y, z) in zip(NAMES, (POINTS * scale).tolist(), strict=True))
    return "\n".join([header, *rows]) + "\n"


PLAN = {"landmarks": [{"name": n, "position": p} for n, p in zip(NAMES, POINTS.tolist(), strict=True)], "poses": []}


def without(content: dict[str, Any], key: str) -> str:
    del content["markups"][0][key]
    return json.dumps(content)


def check_refused(path: Path, text: str, reason: str) -> None:
    """Write a landmark file, and check that it is refused with its name and a reason."""
    path.write_text(text)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_landmarks(path)
    assert str(path) in caught.value.text
    assert caught.value.fields["file"] == str(path)
