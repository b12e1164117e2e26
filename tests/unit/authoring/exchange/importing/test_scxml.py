"""Activities in a blueprint: what cannot be meant is named, and every view of a workflow shows them."""

from __future__ import annotations

from pcmrs.authoring.exchange.importing.scxml import from_scxml


def test_an_invoke_is_not_supported_where_it_is() -> None:
    document = '<scxml xmlns="http://www.w3.org/2005/07/scxml">\n<state id="a">\n<invoke src="x"/></state></scxml>'
    _, findings = from_scxml(document.encode())
    assert [(finding.code, finding.line) for finding in findings] == [("not_supported", 3)]
