"""Any bytes end in findings, or in a blueprint that keeps the static rules, by every importer."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from pcmrs.authoring.exchange.importing.drawio import from_drawio
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm._codes import CODES, EXCHANGE
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.rules import check_rules
from tests.support.trials import examples
from tests.unit.authoring.exchange.random_charts import as_drawio, as_mermaid, as_scxml, deflated, random_chart

Importer = Callable[[bytes, str], tuple[Blueprint | None, list[Finding]]]

IMPORTERS: list[Importer] = [from_scxml, from_mermaid, from_drawio]

fuzzed = examples(60, suppress_health_check=[HealthCheck.too_slow])


def documents(seed: int) -> list[tuple[Importer, bytes]]:
    """A chart in every notation."""
    chart, plain = random_chart(Random(seed)), random_chart(Random(seed), plain=True)
    return [
        (from_scxml, as_scxml(chart).encode()),
        (from_mermaid, as_mermaid(plain).encode()),
        (from_drawio, as_drawio(plain, compressed=False).encode()),
        (from_drawio, as_drawio(plain, compressed=True).encode()),
    ]


def ends_well(importer: Importer, raw: bytes) -> Blueprint | None:
    blueprint, findings = importer(raw, "file")
    if blueprint is None:
        assert findings
        assert all(f.file == "file" and f.code in CODES and f.text for f in findings)
        assert all(f.line >= 1 and f.column >= 1 for f in findings), findings
    else:
        assert not findings
        assert list(check_rules(blueprint)) == []
    return blueprint


@pytest.mark.parametrize("importer", IMPORTERS)
@fuzzed
@given(raw=st.binary(max_size=300))
def test_any_bytes(importer: Importer, raw: bytes) -> None:
    ends_well(importer, raw)


@pytest.mark.parametrize(
    ("importer", "words"),
    [
        (from_mermaid, "stateDiagram-v2\n|state a {|}|--|[*] --> a|a --> b : x|b --> a : x, y|b --> [*]|state b|a : c"),
        (from_scxml, '<scxml>|</scxml>|<state id="a">|</state>|<parallel id="b">|</parallel>|<final id="c"/>|'),
        (from_drawio, '<mxGraphModel>|</mxGraphModel>|<root>|</root>|<mxCell id="a" vertex="1" parent="b"/>|'),
    ],
)
@fuzzed
@given(data=st.data())
def test_any_order_of_words(importer: Importer, words: str, data: st.DataObject) -> None:
    chosen = data.draw(st.lists(st.sampled_from(words.split("|")), max_size=20))
    head = chosen if importer is not from_mermaid else ["stateDiagram", *chosen]
    ends_well(importer, "\n".join(head).encode())


@pytest.mark.parametrize("number", range(4))
@fuzzed
@given(seed=st.integers(0, 10_000), at=st.integers(0, 10_000), new=st.binary(max_size=6), cut=st.integers(0, 30))
def test_mutated_documents(number: int, seed: int, at: int, new: bytes, cut: int) -> None:
    importer, raw = documents(seed)[number]
    place = at % (len(raw) + 1)
    ends_well(importer, raw[:place] + new + raw[place + cut :])


@pytest.mark.parametrize("number", range(4))
@fuzzed
@given(seed=st.integers(0, 10_000), rng=st.randoms(use_true_random=False))
def test_documents_with_words_exchanged(number: int, seed: int, rng: Random) -> None:
    """Wrong targets, parents and initials: what a parser takes and a converter must not."""
    importer, raw = documents(seed)[number]
    separator = "\n" if importer is from_mermaid else '"'
    words = raw.decode().split(separator)
    for _ in range(3):
        one, other = rng.randrange(len(words)), rng.randrange(len(words))
        words[one], words[other] = words[other], words[one]
    ends_well(importer, separator.join(words).encode())


LAUGHS = (
    "<!DOCTYPE scxml [<!ENTITY a 'ha'>"
    + "".join(f"<!ENTITY {chr(98 + i)} '{f'&{chr(97 + i)};' * 10}'>" for i in range(20))
    + "]><scxml><state id='&t;'/></scxml>"
).encode()
DEEP = 5_000
BOMB = f"<mxfile><diagram>{deflated(b'%3CmxGraphModel%3E' + b'a' * 50_000_000)}</diagram></mxfile>".encode()

REFUSED: list[tuple[Importer, bytes, str]] = [
    (from_scxml, LAUGHS, "not_supported"),
    (from_drawio, LAUGHS, "not_supported"),
    (from_scxml, b'<!DOCTYPE scxml SYSTEM "file:///etc/hostname"><scxml/>', "not_supported"),
    (from_scxml, b"<scxml>" + b"<state id='a'>" * DEEP, "too_deep"),
    (from_mermaid, b"stateDiagram-v2\n" + b"state a {\n" * DEEP, "too_deep"),
    (from_scxml, b"<scxml/>" + b" " * MAX_BYTES, "too_large"),
    (from_mermaid, b"\n" * (MAX_BYTES + 1), "too_large"),
    (from_drawio, BOMB, "too_large"),
    (from_drawio, b"<mxfile><diagram>A</diagram></mxfile>", "not_drawio"),
    (from_drawio, b"<mxfile><diagram/><diagram/></mxfile>", "not_supported"),
    (from_drawio, b"<svg/>", "not_drawio"),
    (from_scxml, b"<svg/>", "not_scxml"),
    (from_scxml, b"<scxml/>", "no_states"),
    (from_scxml, b'<scxml><state id="a"><transition event="e" target="b"/></state></scxml>', "unknown_state"),
    (from_scxml, b'<scxml><state id="a"/><state id="a"/></scxml>', "name_collision"),
    (from_scxml, b'<scxml><state id="a"/><state id="A"/></scxml>', "name_collision"),
    (from_scxml, b"<scxml><state/></scxml>", "bad_name"),
    (from_scxml, b'<scxml><state id="a"><transition event="import"/></state></scxml>', "reserved_name"),
    (from_scxml, b"<?xml version='1.0' encoding='EUC-JP'?><scxml/>", "not_xml"),
    (from_scxml, b"<scxml>", "not_xml"),
    (from_mermaid, b"stateDiagram-v2\na\xff", "not_utf8"),
    (from_mermaid, b"graph TD\n", "not_mermaid"),
    (
        from_drawio,
        b'<mxGraphModel><root><mxCell id="0"/><mxCell id="a" value="a" vertex="1" parent="0"/>'
        b'<mxCell id="b" value="b" vertex="1" parent="0"/></root></mxGraphModel>',
        "no_start",
    ),
]


@pytest.mark.parametrize(("importer", "raw", "code"), REFUSED)
def test_refused_import_has_its_code(importer: Importer, raw: bytes, code: str) -> None:
    _, findings = importer(raw, "file")
    assert [finding.code for finding in findings] == [code]


def test_every_code_is_shown_by_an_example() -> None:
    assert {code for _, _, code in REFUSED} >= set(EXCHANGE)
