"""Workflows for tests of the laboratory: RATMS, read once, and a small one of three branches."""

from __future__ import annotations

from functools import cache

from pcmrs.fsm import Blueprint, load_blueprint, parse_blueprint
from pcmrs.workflows import find_workflow
from tests.unit.fsm.rules.small_workflow import SMALL


@cache
def ratms() -> Blueprint:
    return load_blueprint(find_workflow("ratms").blueprint)


@cache
def small() -> Blueprint:
    return parse_blueprint(SMALL.encode())
