"""Arms by name: those of PCMRS's table, those of the package example-robot-data, and any URDF file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

from pcmrs.errors import ConfigurationError
from pcmrs.kinematics._urdf_reader import read_urdf
from pcmrs.kinematics.arms import ARMS, ArmFacts

__all__ = ["find_arm"]

_PACKAGE = "example-robot-data"


@dataclass(frozen=True)
class _Packaged:
    """A URDF of the package, and the facts that a URDF does not hold.

    Attributes:
        file: End of the path of the URDF file.
        flange: Link that carries the tool.
        home: Posture in which the arm waits, clear of a body in front of it, rad, (n,).
        stiffness: Joint stiffness of the simulated arm's impedance controller, N m/rad, (n,).
        link_radius: Radius of the links as capsules, m.
    """

    file: str
    flange: str
    home: tuple[float, ...]
    stiffness: tuple[float, ...]
    link_radius: float


_PACKAGED = {
    "panda": _Packaged(
        "panda_description/urdf/panda.urdf",
        "panda_link8",
        home=(-0.7, -0.62, 0.51, -1.52, 0.34, 0.99, 1.49),
        stiffness=(4000.0, 4000.0, 3000.0, 3000.0, 2000.0, 2000.0, 1500.0),
        link_radius=0.06,
    ),
    "ur5": _Packaged(
        "ur_description/urdf/ur5_robot.urdf",
        "tool0",
        home=(0.0, -1.76, 0.67, -1.01, -1.57, 0.0),
        stiffness=(4000.0, 4000.0, 3000.0, 2000.0, 2000.0, 1500.0),
        link_radius=0.042,
    ),
}

KNOWN = (*ARMS, *_PACKAGED)
"""Names of the known arms. `find_arm` also takes the path of a URDF file."""


def find_arm(model: str) -> ArmFacts:
    """Return the facts of an arm.

    Args:
        model: One of `KNOWN`, or the path of a file that ends in ``.urdf``. The home posture of such an arm is the
            middle of its joint ranges.

    Raises:
        ConfigurationError: The arm is unknown, its file cannot be read or does not describe a usable arm, or the
            package of robot descriptions is not installed.
    """
    if model in ARMS:
        return ARMS[model]
    if model in _PACKAGED:
        return _packaged_arm(model)
    if model.endswith(".urdf"):
        path = Path(model).expanduser()
        return read_urdf(_text_of(path), path.stem)
    text = f"The arm {model!r} is unknown; known are {', '.join(KNOWN)}, and the path of a file that ends in .urdf."
    raise ConfigurationError(text, model=model)


@cache
def _packaged_arm(model: str) -> ArmFacts:
    arm = _PACKAGED[model]
    text = _text_of(_packaged_file(model, arm.file))
    facts = read_urdf(text, model, flange=arm.flange, home=arm.home, stiffness=arm.stiffness)
    return replace(facts, link_radius=arm.link_radius)


def _packaged_file(model: str, file: str) -> Path:
    try:
        known = files(_PACKAGE) or []
    except PackageNotFoundError:
        known = []
    for path in known:
        if path.as_posix().endswith(file):
            return Path(str(path.locate()))
    text = f"The arm {model!r} needs the package {_PACKAGE} with {file}: install pcmrs-sim (docs/supply.md)."
    raise ConfigurationError(text, model=model, package=_PACKAGE)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigurationError(f"The arm's file {path} cannot be read: {reason}.", path=str(path)) from None
