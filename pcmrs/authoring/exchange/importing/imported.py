"""Reads, checks and converts the file of a chart to a blueprint, and writes the blueprint's file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pcmrs.authoring.exchange.importing._chart import Node
from pcmrs.authoring.exchange.importing._convert import blueprint_of
from pcmrs.authoring.exchange.importing._reading import Findings
from pcmrs.errors import BlueprintError
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.fsm.files.load import examine
from pcmrs.fsm.files.toml import MAX_BYTES
from pcmrs.fsm.finding import Finding

__all__ = ["blueprint_file", "import_chart"]


def blueprint_file(blueprint: Blueprint, chart: str, output: str) -> tuple[str, list[Finding]]:
    """Return the blueprint as text, and all that is wrong with it.

    Args:
        blueprint: An imported blueprint.
        chart: The file it was imported from.
        output: Name of its file in findings.

    Returns:
        The text, with the findings that make it unsound. An empty text, with a finding about the chart, if it would be
        too large to be read.
    """
    text = blueprint_toml(blueprint, comment=f"Imported from {Path(chart).name}.")
    if (size := len(text.encode())) > MAX_BYTES:
        fault = f"The blueprint of this chart would have {size} bytes; the limit is {MAX_BYTES}. Split the chart."
        return "", [Finding(code="too_large", text=fault, file=chart, line=1, column=1)]
    return text, examine(text.encode(), origin=output).findings


def import_chart(
    raw: bytes, origin: str, read: Callable[[bytes, Findings], Node]
) -> tuple[Blueprint | None, list[Finding]]:
    """Read, check and convert a chart.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        read: Reads the chart; adds findings or raises `BlueprintError` with them.

    Returns:
        The blueprint, or None and the findings.
    """
    findings = Findings(origin)
    try:
        root = read(raw, findings)
    except BlueprintError as error:
        return None, list(error.fields["findings"])
    if not findings:
        _check(root, findings)
    return None if findings else blueprint_of(root, findings), list(findings)


def _check(root: Node, findings: Findings) -> None:
    nodes = root.by_id()
    for node in root.inside():
        if nodes[node.id] is not node:
            findings.add("name_collision", f"There are two states {node.id!r}: rename one.", node.place)
    if not root.children:
        findings.add("no_states", "There is no state in the chart.", root.place)
    for node in root.walk():
        if node.initial and node.initial not in {child.id for child in node.children}:
            text = f"The initial state {node.initial[:70]!r} is not directly inside {node.display_name or 'the chart'}"
            findings.add("not_supported", f"{text}: not supported.", node.place)
        for edge in node.edges:
            if missing := [target for target in edge.targets if target not in nodes]:
                findings.add("unknown_state", f"There is no state {missing[0][:70]!r} to go to.", edge.place)
            elif missing := [name for group in edge.condition for name in group if name not in nodes]:
                findings.add("unknown_state", f"There is no state {missing[0][:70]!r} to be in.", edge.place)
            elif len(edge.targets) > 1 and not _together(edge.targets, nodes):
                text = f"The targets {' and '.join(edge.targets)} can never be active together."
                findings.add("not_supported", text, edge.place)


def _together(targets: list[str], nodes: dict[str, Node]) -> bool:
    """Return true if any two of the targets lie in different regions of a parallel state."""
    for one in targets:
        for other in targets:
            if one != other and not _apart(nodes[one], nodes[other]):
                return False
    return len(set(targets)) == len(targets)


def _apart(one: Node, other: Node) -> bool:
    around = (other, *other.outward())
    common = next(node for node in (one, *one.outward()) if node in around)
    return common.parallel and common not in (one, other)
