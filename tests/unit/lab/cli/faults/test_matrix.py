"""`pcmrs faults matrix`: the table of attackers and entry points, as a page has it and for programs."""

from __future__ import annotations

import json

import msgspec
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs_lab.campaign.attacks import Attacks, attacks, attacks_as_markdown


def test_the_table_is_printed_as_documents_contain_it() -> None:
    ended = CliRunner().invoke(main, ["faults", "matrix"])
    assert (ended.exit_code, ended.output) == (0, attacks_as_markdown())


def test_programs_get_all_attacks() -> None:
    ended = CliRunner().invoke(main, ["faults", "matrix", "--json"])
    assert msgspec.convert(json.loads(ended.stdout), Attacks) == attacks()
