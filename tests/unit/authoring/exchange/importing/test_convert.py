"""Conversion of a state chart: the same blueprint from every notation, within limits."""

from __future__ import annotations

from random import Random

from pcmrs.authoring.exchange.importing.drawio import from_drawio
from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
from pcmrs.authoring.exchange.importing.scxml import from_scxml
from pcmrs.fsm import Blueprint
from pcmrs.fsm.finding import Finding
from tests.unit.authoring.exchange.random_charts import as_drawio, as_mermaid, as_scxml, flat, random_chart

Import = tuple[Blueprint | None, list[Finding]]


def drawings(seed: int) -> list[Import]:
    """Imports of one chart: from SCXML, Mermaid, draw.io and compressed draw.io."""
    chart = random_chart(Random(seed), plain=True)
    return [
        from_scxml(as_scxml(chart).encode()),
        from_mermaid(as_mermaid(chart).encode()),
        from_drawio(as_drawio(chart, compressed=False).encode()),
        from_drawio(as_drawio(chart, compressed=True).encode()),
    ]


def test_one_chart_in_every_notation() -> None:
    imported = 0
    for seed in range(80):
        (blueprint, findings), *others = drawings(seed)
        imported += blueprint is not None
        for other, said in others:
            assert {f.code for f in said} == {f.code for f in findings}, (seed, findings, said)
            assert (other and other.branches) == (blueprint and blueprint.branches), seed
    assert imported > 40


def test_large_charts_are_converted_or_refused() -> None:
    blueprint, findings = from_scxml(f"<scxml>{flat(1_000, 'next', 's{}')}</scxml>".encode(), "file")
    assert blueprint is not None, findings
    assert len(blueprint.branches["main"].operations) == 1
    _, findings = from_scxml(f"<scxml>{flat(2_000, 'e{}', 's{}')}</scxml>".encode(), "file")
    assert [finding.code for finding in findings] == ["too_large"]
