"""A workflow of one pump, whose only operation that matters is given by each test."""

from __future__ import annotations

PUMP = """
id = "pump"
version = "1"
[branches.pump.states]
off = "off"
on = "on"
[branches.pump.operations]
start = { from = ["off"], to = "on", steps = ["start_pump"], %s }
stop = { from = ["on"], to = "off" }
acknowledge = { from = ["*"], to = { off = "off", on = "on" }, unlatches = true }
"""
