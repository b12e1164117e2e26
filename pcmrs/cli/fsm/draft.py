"""`pcmrs fsm draft`: from the text of a protocol to a proved step table, with a language model."""

from __future__ import annotations

import datetime
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pcmrs.cli.fsm.files import (
    EXIT_UNREADABLE,
    EXIT_UNSOUND,
    check_json_output,
    output_option,
    read,
    refuse,
    write,
)
from pcmrs.cli.options import json_option
from pcmrs.cli.printing import say, say_json, say_lines
from pcmrs.cli.running import readable_errors, run
from pcmrs.clock import SystemClock

if TYPE_CHECKING:
    from pcmrs.authoring.drafting.loop import Draft, DraftRound
    from pcmrs.authoring.drafting.model import ModelSettings


@click.command()
@click.argument("protocol", required=False)
@output_option
@click.option("--url", envvar="PCMRS_MODEL_URL", default="", help="Address of the model's interface.")
@click.option("--model", envvar="PCMRS_MODEL", default="", help="Name of the model.")
@click.option(
    "--config",
    type=click.Path(dir_okay=False, path_type=Path),
    help="TOML file with address, model, key file and limits (docs/draft.md).",
)
@click.option("--rounds", type=click.IntRange(1, 50), default=6, show_default=True, help="Most answers of the model.")
@click.option("--diff", "earlier", help="Earlier step table: list what behaves differently.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Draw the workflow as SVG.")
@click.option("--reviewed", is_flag=True, help="A person has read the text: it has no data of a patient.")
@click.option("--evaluate", is_flag=True, help="Draft the protocols of PCMRS, and count the properties that hold.")
@json_option
@readable_errors
def draft(
    protocol: str | None,
    output: Path | None,
    url: str,
    model: str,
    config: Path | None,
    rounds: int,
    earlier: str | None,
    plot: Path | None,
    reviewed: bool,
    evaluate: bool,
    as_json: bool,
) -> None:
    """Draft the step table of a PROTOCOL, a text file or - for standard input, with a language model.

    The model is any that speaks the chat completions of OpenAI over HTTP, such as one of llama.cpp, Ollama or vLLM; the
    variable PCMRS_MODEL_KEY has its key. Each answer is designed and verified, and all findings go back to the model,
    until the workflow is proved. The table has for each step the sentence that it comes from. Nothing drafted is
    started by a daemon before `pcmrs fsm approve`. Exit status 0: proved, 1: written with its findings in `unresolved`,
    2: no table, or the text may have data of a patient and nobody has confirmed that it has none.
    """
    from pcmrs.authoring.drafting.model import read_model_settings

    check_json_output(output, as_json=as_json)
    settings = read_model_settings(config, url, model)
    if evaluate:
        if protocol is not None:
            raise click.UsageError("--evaluate drafts the protocols of PCMRS: leave PROTOCOL out.")
        return _evaluate(settings, rounds, as_json=as_json)
    if protocol is None:
        raise click.UsageError("Name a PROTOCOL, or - for standard input.")
    text = _protocol(protocol, reviewed=reviewed)
    result = run(_drafted(text, settings, rounds))
    if result.text and (output is not None or not as_json):
        write(result.text, output)
    differences = _differences(result, earlier)
    if plot is not None and result.blueprint:
        _draw(result, plot)
    if as_json:
        keys: dict[str, Any] = {"proved": bool(result.blueprint), "findings": result.findings, "rounds": result.rounds}
        say_json(keys | {"differences": differences})
    else:
        say_lines(differences, err=True)
        say_lines(_questions(result), err=True)
        say_lines(result.findings, err=True)
    if not result.blueprint:
        sys.exit(EXIT_UNSOUND if result.text else EXIT_UNREADABLE)
    return None


def _protocol(file: str, *, reviewed: bool) -> str:
    """Return the text of a protocol once a person is sure that it has no data of a patient."""
    from pcmrs.authoring.drafting.text_checks import warnings_of
    from pcmrs.errors import BlueprintError
    from pcmrs.fsm.files.toml import decode_text

    raw, origin, _ = read(file)
    try:
        text = decode_text(raw, origin)
    except BlueprintError as error:
        refuse(error.text)
    warnings = warnings_of(text)
    say_lines((f"{origin}:{warning.line}: {warning.text}" for warning in warnings), err=True)
    if warnings and not reviewed:
        _ask_or_refuse(file)
    return text


def _ask_or_refuse(file: str) -> None:
    if file == "-" or sys.stdin is None or not sys.stdin.isatty():
        refuse("Read these lines. If they have no data of a patient, and are to be sent, add --reviewed.")
    if not click.confirm("The text is sent to the model. Is it free of data of patients?", err=True):
        refuse("Nothing was sent.")


async def _drafted(text: str, settings: ModelSettings, rounds: int) -> Draft:
    from pcmrs.authoring.drafting.loop import draft as draft_protocol

    async with _client(settings) as client:
        result = await draft_protocol(text, client, _today(), most_rounds=rounds, report=_show_round)
    tokens = f"{client.request_tokens} tokens sent, {client.answer_tokens} received"
    say(f"{tokens}{f', cost {client.cost:.4g}' if client.cost else ''}.", err=True)
    return result


def _client(settings: ModelSettings) -> Any:
    import os

    from pcmrs.authoring.drafting.client import ModelClient
    from pcmrs.authoring.drafting.model import read_key

    key = read_key(settings, os.environ.get("PCMRS_MODEL_KEY", ""))
    return ModelClient.open(settings, key, SystemClock(), lambda line: say(line, err=True))


def _today() -> str:
    return f"{datetime.datetime.fromtimestamp(SystemClock().wall(), datetime.UTC):%Y-%m-%d}"


def _show_round(number: int, done: DraftRound) -> None:
    count = len(done.findings)
    what = "proved" if not count else f"{count} finding{'s' if count != 1 else ''}: {done.findings[0][:200]}"
    say(f"Round {number}: {what}", err=True)


def _questions(result: Draft) -> list[str]:
    if result.table is None:
        return []
    assumed = [f"Assumed: {each.text}" for each in result.table.assumptions]
    return assumed + [f"Question: {each}" for each in result.table.questions]


def _differences(result: Draft, earlier: str | None) -> list[str]:
    """Return what the workflow does differently from that of an earlier table."""
    if earlier is None or not result.blueprint:
        return []
    from pcmrs.authoring.design import design
    from pcmrs.authoring.difference import compare
    from pcmrs.fsm import parse_blueprint

    raw, origin, _ = read(earlier)
    designed = design(raw, origin=origin)
    if designed.findings:
        say_lines(map(str, designed.findings), err=True)
        refuse(f"{origin} makes no sound workflow to compare with.")
    old, new = parse_blueprint(designed.text.encode()), parse_blueprint(result.blueprint.encode())
    return [difference.text for difference in compare(old, new)] or ["The same behaviour."]


def _draw(result: Draft, picture: Path) -> None:
    from pcmrs.authoring import chart
    from pcmrs.fsm import parse_blueprint

    write(chart.svg(parse_blueprint(result.blueprint.encode())), picture)


def _evaluate(settings: ModelSettings, rounds: int, *, as_json: bool) -> None:
    """Draft every protocol of PCMRS, and print how many properties of its right workflow hold after each round."""
    from pcmrs.authoring.drafting.evaluation import Evaluation, evaluate, evaluation_protocols
    from pcmrs.authoring.drafting.model import ModelError

    found: list[Evaluation] = []
    for protocol in evaluation_protocols():
        say(f"{protocol.name}:", err=True)
        try:
            found.append(evaluate(protocol, run(_drafted(protocol.text, settings, rounds))))
        except ModelError as error:
            say(error.text, err=True)
            found.append(Evaluation(protocol.name, len(protocol.properties), [], [], proved=False))
    if as_json:
        say_json({"model": settings.model, "rounds": rounds, "protocols": found})
        return
    say(f"{settings.model}, at most {rounds} rounds: properties of the right workflow that hold after each round")
    for each in found:
        after = ", ".join(map(str, each.held)) or "no answer"
        say(f"{each.protocol:<24} {after} of {each.properties}{', proved' if each.proved else ''}")
    held = sum(each.held[-1] for each in found if each.held)
    say(f"{'together':<24} {held} of {sum(each.properties for each in found)}")
