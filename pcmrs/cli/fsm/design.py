"""`pcmrs fsm design`: from a table of steps to a verified blueprint."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from pcmrs.cli.fsm.files import check_json_output, conclude, output_option, read, write
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_lines
from pcmrs.cli.progress import search_bar
from pcmrs.visible import visible


@click.command()
@click.argument("steps")
@output_option
@json_option
def design(steps: str, output: Path | None, as_json: bool) -> None:
    """Design a workflow from the critical operations in STEPS, a TOML file or - for standard input.

    Asks for the effect of an operation on the patient if STEPS does not declare it; without a terminal that is a
    finding. Reports how many of the 2^N combinations of N steps are possible and why the others are not, on standard
    error if the blueprint goes to standard output. Nothing is written unless the blueprint is sound. With --json,
    standard output gets one object with all this, and the blueprint is written with -o only. Exit status 0: sound, 1:
    unsound, 5: STEPS cannot be read.
    """
    from pcmrs.authoring.design import design as design_blueprint

    check_json_output(output, as_json=as_json)
    raw, origin, _ = read(steps)
    with search_bar(origin) as progress:  # appears after the questions
        result = design_blueprint(raw, origin=origin, progress=progress, ask=_ask if _can_ask(steps) else None)
    if result.combinations is not None and not as_json:
        say_lines(str(result.combinations).splitlines(), err=output is None)
    if result.text and (output is not None or not as_json):
        write(result.text, output)
    combinations = result.combinations
    conclude(origin, result.findings, readable=result.readable, as_json=as_json, combinations=combinations)


QUESTIONS = {
    "moves": "Does {} move the robot?",
    "affects_patient": "Does {} act on the patient in another way, such as an insertion or a pulse?",
    "irreversible": "Is the effect of {} irreversible?",
    "confirm": "Must {} be confirmed each time?",
}


def _can_ask(steps: str) -> bool:
    return steps != "-" and sys.stdin is not None and sys.stdin.isatty()


def _ask(operation: str) -> list[str]:
    """Ask the user, and show what to write into the table, so that the question is asked only once."""
    shown = visible(operation)
    true = [key for key, question in QUESTIONS.items() if click.confirm(question.format(shown), err=True)]
    keys = ", ".join(f"{key} = true" for key in true) or "moves = false"
    say(f"  for the table, at {operation}: {keys}", err=True)
    return true
