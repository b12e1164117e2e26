"""Workflows for tests of the laboratory: RATMS, and a small one of three branches."""

from __future__ import annotations

from functools import cache

from pcmrs.fsm import Blueprint, parse_blueprint
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.rules.small_workflow import SMALL


def ratms() -> Blueprint:
    return shipped_blueprint("ratms")


@cache
def small() -> Blueprint:
    return parse_blueprint(SMALL.encode())
