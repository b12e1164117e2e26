"""Policy of an operator who sees the state: the next step of the procedure."""

from __future__ import annotations

from typing import Any

from pcmrs.messages import Snapshot

Step = tuple[str, dict[str, Any]]
"""Name of an act, and its arguments."""

AT_THE_BODY: dict[str, list[Step]] = {
    "standoff": [("placement.confirm", {}), ("placement.confirm", {}), ("placement.approach", {}), ("pose", {})],
    "placed": [
        ("pose", {}),
        ("placement.confirm", {}),
        ("placement.press", {}),
        ("placement.nudge", {"translation": [0.0, 0.0, 0.001]}),
        ("placement.follow", {}),
        ("placement.back_off", {}),
        ("placement.home", {}),
        ("wire:execute_bkoffset", {}),
    ],
    "replanned": [("placement.approach", {}), ("wire:execute_motionxx", {}), ("placement.back_off", {}), ("pose", {})],
    "guided": [("placement.back_off", {}), ("placement.home", {}), ("placement.stop_guiding", {})],
    "following": [("placement.stop_following", {}), ("placement.home", {}), ("placement.back_off", {})],
}
"""Steps by placement, in the order in which they are done there."""

WITH_STIMULATOR: list[Step] = [
    ("stimulation.set_ceiling", {"percent": 60.0, "operator": "explorer"}),
    ("stimulation.set_intensity", {"percent": 40.0}),
    ("stimulation.arm", {}),
    ("stimulation.fire", {}),
    ("stimulation.fire", {}),
]


def next_step_policy(snapshot: Snapshot | None, turn: int) -> Step:
    """Return the next step.

    Args:
        snapshot: Snapshot that the operator saw last.
        turn: Index that chooses between several possible steps.
    """
    if snapshot is None:
        return "robot.connect", {}
    states = snapshot.branches
    return _to_readiness(snapshot, states, turn) or _at_the_body(states, turn)


def _to_readiness(snapshot: Snapshot, states: dict[str, str], turn: int) -> Step | None:
    if states["robot"] == "0":
        return ("robot.connect" if turn % 2 else "wire:rob_conn_onxxxxx"), {}
    if snapshot.latched:
        named = {"stop": snapshot.stop.number}
        return (
            ("robot.acknowledge", named) if turn % 4 else ("placement.home", {})
        )  # some operators do not check the display
    if states["placement"] in ("unknown", "held"):
        return {"unknown": "placement.locate", "held": "placement.back_off"}[states["placement"]], {}
    step: Step | None = {
        "000": ("landmarks" if turn % 2 else "registration.plan_landmarks", {}),
        "100": ("digitization.digitize_all" if turn % 2 else "wire:start_autodigitz", {}),
        "110": ("registration.register" if turn % 2 else "wire:start_registrati", {}),
    }.get(states["registration"])
    if step is not None:
        return step
    return ("pose" if turn % 2 else "toolplan.plan", {}) if states["toolplan"] == "0" else None


def _at_the_body(states: dict[str, str], turn: int) -> Step:
    placement = states["placement"]
    if "stimulation" in states and placement in ("placed", "following") and turn % 3:
        return WITH_STIMULATOR[turn % len(WITH_STIMULATOR)]
    steps = AT_THE_BODY.get(placement, [("placement.approach", {})])
    return steps[turn % len(steps)]
