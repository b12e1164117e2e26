"""Roles: what somebody on the bus may do, wherever that is decided."""

from __future__ import annotations

from typing import Literal, get_args

Role = Literal["operator", "planner", "viewer", "device", "teleoperator", "daemon", "router"]

ROLES: tuple[Role, ...] = get_args(Role)
PEOPLE: tuple[Role, ...] = ("operator", "planner", "viewer", "teleoperator")
"""Roles of whoever sits at a console, or of the program that does it for them."""
COMMANDING: tuple[Role, ...] = ("operator", "planner", "teleoperator")
"""Roles that may ask for operations at all; a blueprint may say that some of them may not ask for one."""
HOLDING: tuple[Role, ...] = ("operator", "teleoperator")
"""Roles that may hold the lease of a cell."""
INFRASTRUCTURE: tuple[Role, ...] = ("daemon", "router")
"""Roles of processes that others dial."""
