"""The workflow of RATMS, and how often random charts are drawn."""

from __future__ import annotations

from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.load import read_blueprint
from tests.support.ratms_oracle import BLUEPRINT
from tests.support.trials import examples

charts = examples(25)


def ratms() -> Blueprint:
    blueprint, _ = read_blueprint(BLUEPRINT.read_bytes(), "ratms.toml")
    assert blueprint is not None
    return blueprint
