"""Boxes in the cell, and the way that the arm takes beside them."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from pcmrs.messages import JointState, Verdict
from pcmrs.spatial import Floats
from pcmrs.workflows.settings import ProcedureSettings
from tests.unit.workflows.workflow_bench import LANDMARKS, WorkflowBench


def lamp(position: Floats, size: float) -> dict[str, Any]:
    """A cube that stands in the cell, as its only box."""
    box = {"name": "lamp", "pose": {"position": position.tolist()}, "size": [size] * 3}
    return {"zones": {"boxes": [box]}}


def coil(bench: WorkflowBench, positions: list[float]) -> Floats:
    return np.asarray((bench.cell.arm.forward(positions) @ bench.cell.flange_from_tool_tip).translation)


def reason(verdict: Verdict) -> dict[str, Any]:
    assert verdict.reason is not None
    return {"text": verdict.reason.text, **verdict.reason.fields}


async def recorded(bench: WorkflowBench, name: str) -> list[list[float]]:
    """The measured joints during an operation."""
    states: list[JointState] = []
    bench.cell.watchers.append(states.append)
    await bench.accept(name)
    bench.cell.watchers.remove(states.append)
    return [state.positions for state in states]


async def register(bench: WorkflowBench) -> None:
    await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
    await bench.accept("digitization.digitize_all")
    await bench.accept("registration.register")


def settings_with(**body: Any) -> ProcedureSettings:
    return msgspec.convert({"body": body}, ProcedureSettings)
