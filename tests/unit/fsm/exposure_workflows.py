"""Workflows that connect no robot, or one, for tests of exposure."""

from __future__ import annotations

from pcmrs.authoring.design import design
from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from tests import ROOT

BIOPSY = ROOT / "examples/biopsy_steps.toml"
BY_HAND = b"""
id = "injection_steps"
version = "1.0.0"
title = "Injection by hand"

[[steps]]
name = "planned"
operation = "plan_site"
moves = false

[[steps]]
name = "injected"
operation = "inject"
depends_on = ["planned"]
affects_patient = true
"""


def designed(table: bytes) -> Blueprint:
    """The workflow of a step table."""
    blueprint, findings = read_blueprint(design(table).text.encode(), "designed")
    assert blueprint is not None, findings
    return blueprint
