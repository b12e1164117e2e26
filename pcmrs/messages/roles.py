"""Roles: what somebody on the bus may do, wherever that is decided."""

from __future__ import annotations

from typing import Literal, get_args

Role = Literal["operator", "planner", "viewer", "device", "teleoperator", "daemon", "router"]

ROLES: tuple[Role, ...] = get_args(Role)
INFRASTRUCTURE: tuple[Role, ...] = ("daemon", "router")
"""Roles of processes that others dial."""
