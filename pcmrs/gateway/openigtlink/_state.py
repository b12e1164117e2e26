"""The state of all branches as text."""

from __future__ import annotations

import json

from pcmrs.messages import Snapshot


def state_json(snapshot: Snapshot) -> str:
    """Return JSON: ``sequence``, ``branches``, ``flags``, ``running``, ``latched``, ``plan``, ``registration``."""
    return json.dumps(
        {
            "sequence": snapshot.sequence,
            "branches": snapshot.branches,
            "flags": snapshot.flags,
            "running": [f"{each.branch}.{each.operation}" for each in snapshot.running],
            "latched": snapshot.latched,
            "plan": snapshot.plan,
            "registration": snapshot.registration,
        }
    )


def state_line(snapshot: Snapshot) -> str:
    """Return one short line for people."""
    parts = [f"{branch} {state}" for branch, state in snapshot.branches.items()]
    parts += [f"running {each.branch}.{each.operation}" for each in snapshot.running]
    return ("LATCHED, " if snapshot.latched else "") + ", ".join(parts)
