"""The provenance of a drafted workflow in its file and its hash."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from pcmrs.authoring.design import design
from pcmrs.errors import BlueprintError
from pcmrs.fsm import load_blueprint, parse_blueprint
from pcmrs.fsm.blueprint import ProvenanceSpec
from pcmrs.fsm.files.dump import blueprint_toml
from tests.support.shipped import shipped_blueprint
from tests.unit.authoring.design.step_tables import blueprint_of, step, table

ORIGIN = {"model": "made", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}
STEPS = (step("a"), step("b", "a"))


def test_the_blueprint_of_a_table_keeps_the_provenance() -> None:
    blueprint = blueprint_of(table(*STEPS, provenance=ORIGIN))
    assert blueprint.provenance == ProvenanceSpec(**ORIGIN)
    assert parse_blueprint(blueprint_toml(blueprint).encode()) == blueprint


def test_the_hash_covers_the_provenance() -> None:
    """An approval signs the hash."""
    hashes = {
        blueprint_of(table(*STEPS)).hash,
        blueprint_of(table(*STEPS, provenance=ORIGIN)).hash,
        blueprint_of(table(*STEPS, provenance=ORIGIN | {"model": "other"})).hash,
    }
    assert len(hashes) == 3


def test_hash_of_a_workflow_of_people_does_not_know_provenance() -> None:
    """Journals that were written before there was any name this hash."""
    blueprint = shipped_blueprint("ratms")
    assert blueprint.provenance is msgspec.UNSET
    assert b"provenance" not in msgspec.json.encode(blueprint)


def test_a_workflow_that_extends_a_draft_is_a_draft(tmp_path: Path) -> None:
    (tmp_path / "drafted.toml").write_text(design(table(*STEPS, provenance=ORIGIN)).text)
    extending = tmp_path / "more.toml"
    extending.write_text('extends = "drafted.toml"\nid = "more"\nversion = "1"\n')
    assert load_blueprint(extending).provenance == ProvenanceSpec(**ORIGIN)


def test_a_provenance_with_faults_is_refused() -> None:
    with pytest.raises(BlueprintError, match="provenance"):
        parse_blueprint(b'id = "x"\nversion = "1"\nbranches = {}\nprovenance = { model = "made" }\n')
