"""XML as a tree that knows its lines: places, names and texts, and input that is not read."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.exchange.importing._markup import Element, read_xml
from pcmrs.authoring.exchange.importing._reading import MAX_DEPTH
from pcmrs.errors import BlueprintError
from pcmrs.fsm.finding import Finding


def refusal(raw: bytes) -> Finding:
    with pytest.raises(BlueprintError) as refused:
        read_xml(raw, "chart.xml")
    (finding,) = refused.value.fields["findings"]
    assert isinstance(finding, Finding)
    return finding


def depth(element: Element) -> int:
    return 1 + max(map(depth, element.children), default=0)


def test_each_element_knows_where_it_begins() -> None:
    root = read_xml("<a>\n  <b x='ä'/><c/>\n\n <b/></a>".encode(), "chart.xml")
    assert [(child.name, child.place) for child in root.children] == [("b", (2, 3)), ("c", (2, 13)), ("b", (4, 2))]
    assert root.every("b") == [root.children[0], root.children[2]]
    assert root.place == (1, 1)


def test_namespaces_are_taken_apart_from_names() -> None:
    raw = b'<m:a xmlns:m="urn:m" m:id="1" plain="2"><b xmlns="urn:n"/></m:a>'
    root = read_xml(raw, "chart.xml")
    assert (root.namespace, root.name, root.attributes) == ("urn:m", "a", {"id": "1", "plain": "2"})
    assert (root.children[0].namespace, root.children[0].name) == ("urn:n", "b")


def test_a_text_in_several_pieces_is_one() -> None:
    root = read_xml(b"<a>one <b>inner</b>&amp; <![CDATA[<two>]]></a>", "chart.xml")
    assert (root.text, root.children[0].text) == ("one & <two>", "inner")


def test_elements_have_a_deepest_level() -> None:
    whole = b"<a>" * MAX_DEPTH + b"</a>" * MAX_DEPTH
    assert depth(read_xml(whole, "chart.xml")) == MAX_DEPTH
    finding = refusal(b"<a>" + whole + b"</a>")
    assert (finding.code, finding.line, finding.column) == ("too_deep", 1, 3 * MAX_DEPTH + 1)


@pytest.mark.parametrize(
    ("raw", "code", "line"),
    [
        (b"<a>\n<b></a>", "not_xml", 2),
        (b"", "not_xml", 1),
        (b"<?xml version='1.0' encoding='klingon'?><a/>", "not_xml", 1),
        (b"\n<!DOCTYPE a><a/>", "not_supported", 2),
    ],
)
def test_what_is_not_read_is_refused_at_its_line(raw: bytes, code: str, line: int) -> None:
    finding = refusal(raw)
    assert (finding.code, finding.file, finding.line) == (code, "chart.xml", line)
    assert finding.column >= 1


@given(st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="<&\ufffe\uffff")))
def test_any_text_without_markup_comes_back(text: str) -> None:
    assert read_xml(f"<a>{text.replace('>', '&gt;')}</a>".encode(), "chart.xml").text == text
