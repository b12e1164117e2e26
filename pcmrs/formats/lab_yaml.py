"""Readers of the YAML files of the lab's software: landmarks, registration, tool pose, points, calibrations; all in m.

As rotms-ros writes them (Y. Liu, Johns Hopkins University): flow-style braces with comments, points ``p0``, ``p1``, …
in the order in which they were picked, quaternions x y z w.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import Named, Role
from pcmrs.formats.reading import YamlFile, read_text, read_yaml, refuse
from pcmrs.spatial import Transform

LISTS: dict[str, Role] = {"PLANNED": "planned", "DIGITIZED": "digitized"}
FARTHEST = 1.0
"""Largest distance in a calibration, a registration or a plan, m: a larger value was probably written in mm."""
MANY_POINTS = 100_000
"""Limit of the points of a file."""

CALIBRATION = ("x", "y", "z", "rx", "ry", "rz", "rw")
CLOUD = re.compile(r"points[0-9]*", re.ASCII)


def read_lab_landmarks(path: Path) -> tuple[list[Named], Role]:
    """Return planned points in the image, or digitized points in body_ref, m; nan for points not digitized yet.

    Raises:
        FileFormatError: It is not such a file, or ``NUM`` is not the number of points.
    """
    file = read_yaml(path)
    listed = next((name for name in LISTS if name in file.keys), None)
    if listed is None:
        refuse(path, f"has neither the key {' nor '.join(LISTS)}: give a file of landmarks.")
    points = _mapping(file, (listed,))
    found: list[Named] = [
        (str(name), _numbers(file, (listed, str(name)), values, "xyz")) for name, values in points.items()
    ]
    if file.keys.get("NUM", len(found)) != len(found):
        file.refuse(
            ("NUM",),
            f"says NUM: {file.keys['NUM']}, but {listed} holds {len(found)} points: save it again.",
            num=file.keys["NUM"],
        )
    return found, LISTS[listed]


def read_lab_pose(path: Path) -> Transform:
    """Return the pose in a file of a registration (body_ref_from_image) or of a tool plan (image_from_tool_tip).

    Raises:
        FileFormatError: A part is missing, incomplete, not finite, not a unit quaternion, or farther than `FARTHEST`.
    """
    file = read_yaml(path)
    pose = lab_pose(file)
    _check_distance(file, ("TRANSLATION",), pose)
    return pose


def lab_pose(file: YamlFile, *at: str) -> Transform:
    """Return the pose in ``TRANSLATION`` (x y z, m) and ``ROTATION`` (quaternion x y z w) of a mapping.

    Args:
        file: The file.
        at: Keys on the way to the mapping; none for the top of the file.

    Raises:
        FileFormatError: A part is missing, incomplete, not finite, or not a unit quaternion.
    """
    keys = _mapping(file, at) if at else file.keys
    position = _numbers(file, (*at, "TRANSLATION"), keys.get("TRANSLATION"), "xyz")
    quat_xyzw = _numbers(file, (*at, "ROTATION"), keys.get("ROTATION"), "xyzw")
    return _pose(file, at or ("ROTATION",), position, quat_xyzw)


def read_lab_calibration(path: Path) -> Transform:
    """Return the pose in a calibration file: ``x y z`` in m and the quaternion ``rx ry rz rw``.

    The name of the file says what it is: ``a_b.yaml`` holds ``a_from_b``.

    Raises:
        FileFormatError: A number is missing, there are others, they are no pose, or it is farther than `FARTHEST`.
    """
    file = read_yaml(path)
    numbers = _numbers(file, (), file.keys, CALIBRATION)
    pose = _pose(file, ("rx",), numbers[:3], numbers[3:])
    _check_distance(file, ("x",), pose)
    return pose


def read_lab_cloud(path: Path) -> list[tuple[float, float, float]]:
    """Return the points touched on the surface, in body_ref, m; none if the file is empty, as after it was cleared.

    Raises:
        FileFormatError: A value is not a text of numbers, three for each point.
    """
    if not read_text(path).strip():
        return []
    file = read_yaml(path)
    points: list[tuple[float, float, float]] = []
    for name, value in file.keys.items():
        if not CLOUD.fullmatch(str(name)) or not isinstance(value, str):
            file.refuse((str(name),), f'holds {name}: a cloud is points0: "x,y,z,x,y,z,", in m.', key=str(name))
        points += _cloud(file, str(name), value)
        if len(points) > MANY_POINTS:  # a short file may refer to one long text many times
            text = f"holds more than {MANY_POINTS} points: leave clouds out."
            file.refuse((str(name),), text, limit=MANY_POINTS)
    return points


def read_refined(path: Path) -> bool:
    """Return True if a registration file says that a surface was used for it (``FLAG_ICP``).

    Raises:
        FileFormatError: The flag is neither 0 nor 1.
    """
    file = read_yaml(path)
    flag = file.keys.get("FLAG_ICP", 0)
    if flag not in (0, 1):
        file.refuse(("FLAG_ICP",), f"says FLAG_ICP: {flag}; it must be 0, or 1 after ICP.", flag=str(flag))
    return bool(flag)


def _cloud(file: YamlFile, name: str, text: str) -> list[tuple[float, float, float]]:
    numbers = [part.strip() for part in text.split(",") if part.strip()]
    try:
        values = [float(number) for number in numbers]
    except ValueError:
        values = []
    if len(values) != len(numbers) or not all(map(math.isfinite, values)):
        file.refuse((name,), f"holds something under {name} that is not a finite number; digitize again.", key=name)
    if len(values) % 3:
        text = f"holds {len(values)} numbers under {name}, not three for each point: the file was cut; digitize again."
        file.refuse((name,), text, key=name)
    points = zip(values[::3], values[1::3], values[2::3], strict=True)
    return list(points)


def _pose(file: YamlFile, at: tuple[str, ...], position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> Transform:
    try:
        return Transform.from_quat_xyzw(position, quat_xyzw)
    except GeometryError as error:
        file.refuse(at, f"holds no pose under {'.'.join(at)}: {error.text}")


def _check_distance(file: YamlFile, at: tuple[str, ...], pose: Transform) -> None:
    length = math.hypot(*pose.translation)
    if length > FARTHEST:
        text = f"holds a translation of {length:g} m, the limit is {FARTHEST:g} m: write it in m, not in mm."
        file.refuse(at, text, length=length, limit=FARTHEST)


def _mapping(file: YamlFile, at: tuple[str, ...]) -> dict[Any, Any]:
    found: Any = file.keys
    for name in at:
        found = found.get(name) if isinstance(found, dict) else None
    if not isinstance(found, dict):
        file.refuse(at, f"holds no braces with values under {'.'.join(at)}.", key=".".join(at))
    return found


def _numbers(file: YamlFile, at: tuple[str, ...], given: Any, axes: str | tuple[str, ...]) -> tuple[float, ...]:
    place = f" under {'.'.join(at)}" if at else ""
    if not isinstance(given, Mapping):
        file.refuse(at, f"holds no braces with values{place}.", key=".".join(at))
    if set(given) != set(axes):
        has = ", ".join(map(str, given)) or "nothing"
        file.refuse(at, f"needs {', '.join(axes)}{place}, not {has}.", key=".".join(at))
    numbers = []
    for axis in axes:
        number = _number(given[axis])
        if number is None:
            shown = given[axis] if isinstance(given[axis], str | bool) else type(given[axis]).__name__
            text = f"holds something{place} that is not a number: {axis}: {str(shown)[:40]}."
            file.refuse((*at, axis), text, key=axis)
        numbers.append(number)
    return tuple(numbers)


def _number(value: Any) -> float | None:
    """Return a number of a YAML file; None for anything else.

    By way of text: YAML reads 1e-05 and nan, which C++ writes, as text, and true must not count as 1.
    """
    try:
        return float(str(value)) if isinstance(value, int | float | str) else None
    except ValueError:
        return None
