"""A workflow ready to run: its blueprint, what the names in it stand for, and its data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic

from pcmrs.dispatcher.registry import Registry
from pcmrs.dispatcher.run import C, D
from pcmrs.fsm import Blueprint, Effect

Settle = Callable[[D, Mapping[str, str], Sequence[Effect]], D]
"""Fits the data to a commit: (data, joint state after it, its effects) → data. Pure."""


@dataclass(frozen=True)
class Workflow(Generic[C, D]):
    """Everything the dispatcher needs to know of a procedure.

    Raises:
        BlueprintError: The blueprint uses a name that the registry does not know, or does not declare that a step moves
            the robot or affects the patient.
    """

    blueprint: Blueprint
    registry: Registry[C, D]
    initial: D
    settle: Settle[D]

    def __post_init__(self) -> None:
        self.registry.check_names(self.blueprint)
        self.registry.check_declarations(self.blueprint)
