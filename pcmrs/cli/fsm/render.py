"""`pcmrs fsm render`: the state chart of a workflow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import click

from pcmrs.cli.fsm.files import fail_with_findings, file_argument, output_option, read, refuse, write
from pcmrs.errors import ConfigurationError
from pcmrs.fsm import Blueprint, examine
from pcmrs.fsm.files.load import read_blueprint
from pcmrs.fsm.rules import check_rules

FORMATS = ("svg", "png", "mermaid", "dot")


def _states(_context: click.Context, _parameter: click.Parameter, given: tuple[str, ...]) -> dict[str, str]:
    pairs = [text.partition("=") for text in given]
    for branch, equals, state in pairs:
        if not (branch and equals and state):
            raise click.BadParameter(f"{branch + equals + state!r} is not of the form branch=state.")
    return {branch: state for branch, _, state in pairs}


@click.command()
@file_argument
@click.option("--format", "form", type=click.Choice(FORMATS), default="svg", show_default=True, help="What to write.")
@click.option(
    "--state",
    "current",
    multiple=True,
    metavar="BRANCH=STATE",
    callback=_states,
    help="Highlight this state; may be repeated.",
)
@output_option
def render(file: str, form: str, current: Mapping[str, str], output: Path | None) -> None:
    """Draw the state chart of FILE.

    Branches stand side by side, those of a deeper level inside the frame of the branch that they refine. svg and png
    are the same picture; dot is for Graphviz, mermaid for pages that draw stateDiagram-v2. A FILE that only the search
    of `verify` finds unsound can be drawn.
    """
    try:
        write(_drawing(form)(_drawable(file), current), output)
    except ConfigurationError as error:
        refuse(error.text)


def _drawable(file: str) -> Blueprint:
    """Return the workflow in a file if it obeys the static rules; otherwise print its findings and end the command."""
    raw, origin, folder = read(file)
    blueprint, findings = read_blueprint(raw, origin, folder)
    if blueprint is None:
        fail_with_findings(findings, readable=False)
    if any(True for _ in check_rules(blueprint)):
        fail_with_findings(examine(raw, origin=origin, folder=folder).findings, readable=True)
    return blueprint


def _drawing(form: str) -> Callable[[Blueprint, Mapping[str, str]], str | bytes]:
    from pcmrs.authoring import chart

    drawings: dict[str, Callable[[Blueprint, Mapping[str, str]], str | bytes]] = {
        "svg": chart.svg,
        "png": lambda blueprint, current: chart.png(chart.svg(blueprint, current)),
        "mermaid": chart.mermaid,
        "dot": chart.dot,
    }
    return drawings[form]
