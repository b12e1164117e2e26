"""Commands on a running cell: call, next, state, watch, keys, stop."""

from __future__ import annotations

import json
import sys
from datetime import datetime
from typing import TYPE_CHECKING, Any

import click
import msgspec

from pcmrs.cli.options import CellAddress, address_options, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.quantities import readable
from pcmrs.cli.running import EXIT_FAILED, EXIT_REJECTED, EXIT_UNKNOWN, readable_errors, run
from pcmrs.cli.values import Arguments, Operation
from pcmrs.errors import PcmrsError
from pcmrs.messages import DeviceEvent, NextStep, Running, Snapshot, UnknownOutcome, Verdict

if TYPE_CHECKING:
    # For annotations only: asking for help must not load the bus.
    from pcmrs.bus.keys import KeyTable
    from pcmrs.client import Event

STATUS = {"accepted": 0, "rejected": EXIT_REJECTED, "failed": EXIT_FAILED, "unknown": EXIT_UNKNOWN}


@click.command()
@click.argument("operation", metavar="BRANCH.OPERATION", type=Operation())
@click.argument("arguments", metavar="[JSON|@FILE]", default="{}", type=Arguments())
@json_option
@address_options
@readable_errors
def call(operation: str, arguments: dict[str, Any], as_json: bool, address: CellAddress) -> None:
    """Ask for an operation and print the verdict.

    Arguments are a JSON object, or @FILE for one in a file.
    Exit status: 0 accepted, 1 rejected, 3 no daemon, 5 failed, 6 unknown.

    Example: pcmrs call digitization.digitize_one '{"index": 0}'
    """
    verdict = run(_call(address, operation, arguments))
    say(_json(verdict) if as_json else event_line(verdict))
    if verdict.decision != "accepted" and verdict.allowed and not as_json:
        say(f"  allowed now: {', '.join(verdict.allowed)}")
    sys.exit(STATUS[verdict.decision])


@click.command("next")
@click.argument("operation", metavar="[BRANCH.OPERATION]", default="")
@json_option
@address_options
@readable_errors
def next_(operation: str, as_json: bool, address: CellAddress) -> None:
    """Print the next step of the procedure, or the next step towards an operation, and why.

    It follows from the verified workflow and the present states. Checks of data and devices may still refuse it.

    Exit status: 0 there is one or nothing is left, 1 nothing leads on, 3 no daemon.

    Example: pcmrs next placement.approach
    """
    found = run(_next(address, operation))
    if as_json:
        say(_json(found))
    else:
        _print_next(found)
    sys.exit(0 if found.next or not (operation or found.stage) else EXIT_REJECTED)


@click.command()
@json_option
@address_options
@readable_errors
def state(as_json: bool, address: CellAddress) -> None:
    """Print the state of all branches, the flags, running operations, and unknown outcomes."""
    snapshot = run(_state(address))
    if as_json:
        say(_json(snapshot))
    else:
        _print_snapshot(snapshot)


@click.command()
@json_option
@address_options
@readable_errors
def watch(as_json: bool, address: CellAddress) -> None:
    """Print states, decisions and device events as they happen, until interrupted."""
    run(_watch(address, as_json=as_json))


@click.command()
@json_option
@address_options
@readable_errors
def keys(as_json: bool, address: CellAddress) -> None:
    """List the keys to publish and subscribe to, with their payloads."""
    from rich.table import Table  # not at the top: stop must not load Rich first

    from pcmrs.cli.tables import Terminal

    table = run(_keys(address))
    if as_json:
        say(_json(table))
        return
    shown = Table("key", "use", "payload", "what for", title=f"below {table.prefix}/", title_justify="left")
    for row in table.keys:
        shown.add_row(row.key, row.use, row.payload, row.text)
    Terminal().print(shown)


@click.command()
@json_option
@address_options
@readable_errors
def stop(as_json: bool, address: CellAddress) -> None:
    """Stop every motion and latch: nothing moves until the stop is acknowledged, in RATMS by robot.acknowledge.

    Exit status: 0 the robot stands, 1 it is not confirmed that it stands, 3 no daemon.
    """
    number, stands, release = run(_stop(address))
    if as_json:
        say_json({"stop": number, "stands": stands, "release": release})
        raise SystemExit(0 if stands else EXIT_REJECTED)
    if not stands:
        say(f"Stop {number} has started, but it is not confirmed that the robot stands still: look at it.", err=True)
        raise SystemExit(EXIT_REJECTED)
    say(f"stopped, and {_latched(release, number)}")


async def _call(address: CellAddress, operation: str, arguments: dict[str, Any]) -> Verdict:
    async with address.connect() as client:
        return await client.call(operation, arguments)


async def _next(address: CellAddress, operation: str) -> NextStep:
    async with address.connect() as client:
        return await client.next_step(operation)


async def _state(address: CellAddress) -> Snapshot:
    async with address.connect() as client:
        return client.greeting


async def _watch(address: CellAddress, *, as_json: bool) -> None:
    missed, shown = 0, ""
    async with address.connect() as client:
        async for event in client.watch():
            if client.missed > missed:
                text = f"{client.missed - missed} events are left out: they arrived faster than they were read."
                say(text, err=True)
                missed = client.missed
            line = _json(event) if as_json else event_line(event)
            if isinstance(event, Snapshot):
                if line == shown:
                    continue  # the change, such as a value of an activity, is not on the line
                shown = line
            say(line)


async def _keys(address: CellAddress) -> KeyTable:
    async with address.connect() as client:
        return await client.keys()


async def _stop(address: CellAddress) -> tuple[int, bool, list[str] | None]:
    """Stop, and return its number, whether the robot stands, and what releases the latch, None if not reported."""
    async with address.connect() as client:
        number = (await client.stop()).number
        stands = await client.standstill(number)
        try:
            return number, stands, (await client.state(timeout=2.0)).release
        except PcmrsError:  # Stop has started, as requested
            return number, stands, None


def _json(message: msgspec.Struct) -> str:
    return msgspec.json.encode(message).decode()


def event_line(event: Event) -> str:
    """Return a snapshot, a verdict or a device event on one line."""
    if isinstance(event, Snapshot):
        states = " ".join(f"{branch}={state}" for branch, state in event.branches.items())
        unknown = "".join(f" unknown {each.branch}.{each.operation}" for each in event.unknown)
        running = "".join(_running(each, " running ") for each in event.running)
        return f"#{event.sequence} {states}{running}{' LATCHED' if event.latched else ''}{unknown}"
    if isinstance(event, DeviceEvent):
        return f"{event.device}: {event.code}: {event.text}"
    line = f"{event.decision}: {event.branch}.{event.operation}"
    if event.state:
        line += f", {event.branch} is in {event.state}"
    if event.reason is not None:
        line += f": {event.reason.code}: {event.reason.text}"
    return line + (f": {readable(event.result)}" if event.result else "")


def _running(running: Running, head: str) -> str:
    """Return an operation in progress after a head, with the prompt for the person if there is one."""
    prompt = "" if running.prompt is None else f" [{running.prompt.text}]"
    return f"{head}{running.branch}.{running.operation} {running.progress:.0%}{prompt}"


def _print_next(found: NextStep) -> None:
    if found.next:
        say(f"{'wait for' if found.awaited else 'next'}: {found.next}")
    say(found.why)
    for stage in found.stages:
        mark = "x" if stage.reached else ">" if stage.id == found.stage else " "
        say(f"[{mark}] {stage.id}: {stage.title}")


def _unknown(outcome: UnknownOutcome) -> str:
    since = datetime.fromtimestamp(outcome.since).astimezone().isoformat(sep=" ", timespec="seconds")
    command = f"{outcome.branch}.{outcome.operation} (command {outcome.command} of {outcome.source}, {since})"
    return f"unknown: {command}: check it, then settle it: a motion by placement.locate, others by acknowledging"


def _print_snapshot(snapshot: Snapshot) -> None:
    # In lines, because Rich would take most of the time of the command.
    say(f"{snapshot.blueprint.id} {snapshot.blueprint.version}")
    width = max(map(len, snapshot.branches), default=0)
    for branch, name in snapshot.branches.items():
        say(f"{branch:<{width}}  {name}")
    raised = [flag for flag, value in snapshot.flags.items() if value]
    say(f"flags: {', '.join(raised) or 'none'}; sequence {snapshot.sequence}")
    for running in snapshot.running:
        say(_running(running, "running: "))
    for outcome in snapshot.unknown:
        say(_unknown(outcome))
    if snapshot.latched:
        say(_latched(snapshot.release, snapshot.stop.number))


def _latched(release: list[str] | None, stop: int) -> str:
    """Describe the latch, and the commands that release it by naming the Stop that the person sees here.

    Args:
        release: Operations of the running workflow that release the latch; None if the daemon did not report them.
        stop: Number of the newest Stop.
    """
    if release is None:
        return "latched until it is acknowledged (pcmrs state shows how)"
    if not release:
        return "latched; no operation of this workflow is barred by that"
    named = json.dumps({"stop": stop})
    commands = [f"pcmrs call {each} '{named}'" for each in release]
    return f"latched until it is acknowledged: {' or '.join(commands)}"
