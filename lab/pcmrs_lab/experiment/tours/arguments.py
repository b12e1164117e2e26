"""Arguments for every operation of a workflow, so that each can be requested without a person."""

from __future__ import annotations

import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from pcmrs.errors import ConfigurationError
from pcmrs.fsm.behaviour import operations
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.spatial import Transform
from pcmrs.testing.plan import Plan
from pcmrs_lab.experiment.treatment import CONFIRMED

Table = dict[str, Any]

NUDGES: list[Table] = [{"translation": [0.0, 0.0, 0.001]}, {"translation": [0.0, 0.0, -0.001]}]
"""Small motions away from the body and back."""

PRESSES: list[Table] = [{}, {"force": 1.0}]
"""Presses with the configured force, and with the least."""

ENOUGH_POINTS = 30
"""Number of skin points with which a registration can be refined."""

DEPTH = 0.03
"""Depth of a trajectory from the planned pose into the body, m."""


class TourArguments:
    """Arguments for operations, used in turn.

    Args:
        given: Arguments, or a list of them to be used in turn, by ``branch.operation`` or by name of a payload.
    """

    def __init__(self, given: Mapping[str, Table | list[Table]]) -> None:
        self._given = {name: [tables] if isinstance(tables, dict) else tables for name, tables in given.items()}
        self._used: Counter[str] = Counter()

    def missing(self, blueprint: Blueprint) -> dict[str, str]:
        """Return the operations without arguments, and the payloads that they need."""
        payloads = {f"{branch}.{operation}": spec.payload for branch, operation, spec in operations(blueprint)}
        return {name: payload for name, payload in payloads.items() if not self._tables(name, payload)}

    def choices(self, blueprint: Blueprint) -> dict[str, int]:
        """Return the number of different arguments for each operation."""
        payloads = {f"{branch}.{operation}": spec.payload for branch, operation, spec in operations(blueprint)}
        return {name: len(self._tables(name, payload)) for name, payload in payloads.items()}

    def next(self, name: str, payload: str) -> Table:
        """Return the next arguments in turn; empty if there are none.

        Args:
            name: Operation, ``branch.operation``.
            payload: Name of its payload type.
        """
        tables, used = self._tables(name, payload), self._used[name]
        self._used[name] += 1
        return tables[used % len(tables)] if tables else {}

    def _tables(self, name: str, payload: str) -> list[Table]:
        if name in self._given:
            return self._given[name]
        return [{}] if payload == "none" else self._given.get(payload, [])


def plan_arguments(plan: Plan) -> dict[str, Table | list[Table]]:
    """Return arguments of the payloads that a plan has values for, and of the confirmations of a person."""
    pose = plan.poses[0]
    inwards = Transform.from_quat_xyzw(pose.position, pose.quat_xyzw) @ np.array([0.0, 0.0, -DEPTH])
    return {
        "landmarks": {"landmarks": msgspec.to_builtins(plan.landmarks)},
        "landmark_names": [{"names": [plan.landmarks[0].name]}],
        "landmark_index": [{"index": index} for index in range(len(plan.landmarks))],
        "surface_points": {"points": ENOUGH_POINTS},
        "surface_name": {},
        "tool_pose": msgspec.to_builtins(pose),
        "trajectory": {"entry": list(pose.position), "target": inwards.tolist()},
        "confirmation": dict(CONFIRMED),
        "nudge": NUDGES,
        "press": PRESSES,
        "retreat": {"confirm": True},
    }


def read_arguments(path: Path) -> dict[str, Table | list[Table]]:
    """Return the arguments of a TOML file, by ``"branch.operation"`` or by payload.

    Raises:
        ConfigurationError: The file cannot be read, or contains something else than tables and lists of tables.
    """
    try:
        given = tomllib.loads(path.read_text())
        return msgspec.convert(given, dict[str, Table | list[Table]])
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, msgspec.ValidationError, RecursionError) as error:
        raise ConfigurationError(f"{path} contains no valid arguments: {error}.") from None
