"""The provenance of a draft goes with it to other tools, and comes back."""

from __future__ import annotations

from pcmrs.authoring.exchange.exporting.promela import promela
from pcmrs.authoring.exchange.exporting.scxml import scxml
from pcmrs.authoring.exchange.exporting.table import table as markdown
from pcmrs.authoring.exchange.importing.imported import blueprint_file
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import parse_blueprint
from tests.unit.authoring.design.step_tables import blueprint_of, step, table

ORIGIN = {"model": "made <&> */ |", "prompt": "ab", "protocol": "cd", "date": "2026-11-27"}
DRAFTED = blueprint_of(table(step("a"), step("b", "a"), provenance=ORIGIN))
WRITTEN = blueprint_of(table(step("a"), step("b", "a")))


def test_a_draft_that_was_exported_and_imported_is_a_draft() -> None:
    imported, findings = from_scxml(scxml(DRAFTED).encode())
    assert findings == []
    assert imported is not None
    assert imported.provenance == DRAFTED.provenance
    text, _ = blueprint_file(imported, "drafted.scxml", "drafted.toml")
    assert parse_blueprint(text.encode()).provenance == DRAFTED.provenance


def test_a_provenance_that_cannot_be_read_is_not_lost() -> None:
    imported, findings = from_scxml(scxml(DRAFTED).replace('model="', 'modell="').encode())
    assert imported is None
    assert [finding.code for finding in findings] == ["not_supported"]
    assert "provenance of this draft" in findings[0].text


def test_a_provenance_below_another_element_counts() -> None:
    text = scxml(DRAFTED)
    begin = text.index("<pcmrs:provenance")
    end = text.index("/>", begin) + 2
    moved = text[:begin] + text[end:].replace("</state>", f"{text[begin:end]}</state>", 1)
    imported, _ = from_scxml(moved.encode())
    assert imported is not None
    assert imported.provenance == DRAFTED.provenance


def test_people_see_who_has_drafted_a_workflow() -> None:
    assert "\n\nDrafted by made <&> */ \\| on 2026-11-27, prompt ab" in markdown(DRAFTED)
    assert "Drafted by made <&> * / | on 2026-11-27" in promela(DRAFTED)
    assert promela(DRAFTED).partition("*/")[2] == promela(WRITTEN).partition("*/")[2]
    for text in (markdown(WRITTEN), promela(WRITTEN), scxml(WRITTEN)):
        assert "provenance" not in text
        assert "Drafted" not in text
