"""Workflows of other tools: state charts that `pcmrs fsm import` reads, and tables of steps of `pcmrs fsm design`.

python -m fuzz.authoring -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.authoring", "pcmrs.fsm"):
    from pcmrs.authoring.design import design
    from pcmrs.authoring.exchange.importing.drawio import from_drawio
    from pcmrs.authoring.exchange.importing.imported import blueprint_file
    from pcmrs.authoring.exchange.importing.mermaid import from_mermaid
    from pcmrs.authoring.exchange.importing.scxml import from_scxml

READERS = (from_scxml, from_mermaid, from_drawio)


def one(data: bytes) -> None:
    """Import a chart, or design from a table of steps; the first byte selects the format.

    There is a blueprint, or there are findings.
    """
    number, rest = data[0] % 4 if data else 0, data[1:]
    if number == len(READERS):
        designed = design(rest, origin="steps")
        assert designed.findings or designed.text
        return
    blueprint, findings = READERS[number](rest, "chart")
    assert (blueprint is None) == bool(findings)
    if blueprint is not None:
        text, unsound = blueprint_file(blueprint, "chart", "blueprint")
        assert text or unsound


if __name__ == "__main__":
    run(one)
