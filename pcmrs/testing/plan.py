"""Plan files: landmarks and tool poses of a phantom, in image coordinates."""

from __future__ import annotations

from pathlib import Path

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.workflows.data import Landmark
from pcmrs.workflows.toolplan import ToolPose

__all__ = ["Plan", "example_plan", "read_plan"]


class Plan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Plan of a procedure, in image coordinates: m and quaternions x y z w.

    Attributes:
        landmarks: Landmarks in order.
        poses: Tool poses.
    """

    landmarks: tuple[Landmark, ...]
    poses: tuple[ToolPose, ...]


def example_plan(workflow: str) -> Path:
    """Return the path of the example plan for a workflow: in the installed package, or in ``examples/`` beside it."""
    package = Path(__file__).parents[1]
    name = f"examples/{workflow}_plan.json"
    return next((folder / name for folder in (package, package.parent) if (folder / name).exists()), Path(name))


def read_plan(path: Path) -> Plan:
    """Read a plan file.

    Raises:
        ConfigurationError: The file cannot be read or is not a plan.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=Plan)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    except (msgspec.MsgspecError, RecursionError) as error:
        raise ConfigurationError(f"{path} is not a plan: {error}.", file=str(path)) from None
