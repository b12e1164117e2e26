"""Random step tables of which some steps move the robot, affect the patient or cannot be undone."""

from __future__ import annotations

from random import Random
from typing import Any

WAYS = ("moves", "affects_patient", "irreversible", "confirm")


def hazard_table(rng: Random) -> dict[str, Any]:
    """A table of up to four steps on the first level, at least one of them a hazard; each ``x`` is done by ``do_x``."""
    steps: list[dict[str, Any]] = []
    for number in range(rng.randint(1, 4)):
        name = f"s{number}"
        needs = [step["name"] for step in steps if rng.random() < 0.4]
        steps.append({"name": name, "operation": f"do_{name}", "depends_on": needs} | _plain_or_refined(rng, name))
    if not any(_is_hazard(step) for step in steps):
        steps.append({"name": "last", "operation": "do_last", "depends_on": [steps[-1]["name"]], "moves": True})
    rng.shuffle(steps)
    return {"id": "hazard_table", "version": "1", "steps": steps}


def _plain_or_refined(rng: Random, name: str) -> dict[str, Any]:
    kind = rng.random()
    if kind < 0.15:
        below = [
            {"name": f"{name}_{i}", "operation": f"do_{name}_{i}", "moves": False} for i in range(rng.randint(1, 2))
        ]
        return {"operation": f"signal_{name}", "refined_by": {"branch": f"inside_{name}", "steps": below}}
    if kind < 0.25:
        hazard = {"moves": rng.random() < 0.5, "affects_patient": rng.random() < 0.5, "confirm": rng.random() < 0.2}
        points = {"branch": f"points_{name}", "points": rng.randint(1, 3)}
        return hazard | {"operation": f"signal_{name}", "steps": ["work"], "refined_by": points}
    step: dict[str, Any] = {"moves": False}
    if rng.random() < 0.6:
        step = {way: rng.random() < 0.4 for way in WAYS}
    if step["moves"] and rng.random() < 0.2:
        step["moves"] = "retreat"
    if rng.random() < 0.6:
        step["steps"] = ["work"]
    if rng.random() < 0.4:
        back = rng.choice([f"undo_{name}", {"operation": f"undo_{name}", "steps": ["work"], "moves": "retreat"}])
        step["reopened_by"] = [back]
    if rng.random() < 0.2:
        partial = rng.random() < 0.5 and not step.get("irreversible")
        step["alternatives"] = [{"operation": f"try_{name}", "partial": partial, "steps": ["work"]}]
    return step


def _is_hazard(step: dict[str, Any]) -> bool:
    return any(step.get(way) for way in WAYS[:3])
