"""Faults of datagrams: a proxy between planner and daemon, datagrams of any sender, or receive errors of the kernel."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any, NamedTuple

from pcmrs.errors import UnknownOutcomeError
from pcmrs.gateway.commands import Value
from pcmrs.journal import JournalRow
from pcmrs.planner import REPEAT_AFTER, Planner, PlannerVerdict
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE, digitize_landmarks, plan, register, state
from pcmrs.testing.errors import Unmet
from pcmrs.testing.proxy import udp_proxy
from pcmrs_lab.campaign.checks import expect
from pcmrs_lab.campaign.datagrams import raw_socket, refused_all, send_accepted
from pcmrs_lab.campaign.fault import Evidence, fault
from pcmrs_lab.campaign.lab import Lab
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.syscalls import NEEDS, injected
from pcmrs_lab.campaign.waiting import until_true

PROXY = "userspace proxy between planner and daemon, UDP"
RECEIVING = ("recvmsg", "recvmmsg", "recvfrom")
COMMANDS_SENT = 12
IMPATIENT = 0.4
"""Timeout of a sender that gives up before a late verdict comes, s of the machine."""


@fault("N1", how=PROXY)
async def datagrams_are_lost(lab: Lab) -> Evidence:
    """A fifth of the datagrams is lost, in both directions."""
    impairment = InjectedImpairment(seed=lab.seed, loss=0.2)
    return await _check_exactly_once(lab, impairment, "lost", lambda sent: {"commands_sent_again": sent.repeated})


@fault("N2", how=PROXY)
async def datagrams_are_doubled(lab: Lab) -> Evidence:
    """Half of the datagrams come twice."""
    impairment = InjectedImpairment(seed=lab.seed, doubled=0.5)
    return await _check_exactly_once(
        lab,
        impairment,
        "doubled",
        lambda sent: {"more_than_were_sent": max(0, sent.arrived - sent.done - sent.repeated)},
    )


@fault("N3", how=PROXY)
async def datagrams_overtake_each_other(lab: Lab) -> Evidence:
    """A series of landmarks in any order is planned whole as sent, or refused with its reason."""
    impairment = InjectedImpairment(seed=lab.seed, jitter=0.2)
    async with lab.cell() as cell, _proxied(cell, impairment) as planner:
        row = cell.last_row()
        points = [landmark.position for landmark in plan().landmarks]
        sent: list[tuple[str, tuple[Value, ...]]] = [("img_fid_numxxxxx", (len(points),))]
        sent += [("img_fid_pntxxxxx", (index, *map(float, point))) for index, point in enumerate(points)]
        sent += [("img_fid_lastrecv", ())]
        verdicts = await _send_at_once(planner, sent)
        planned = [entry for entry in cell.rows(row) if entry.kind == "outcome" and entry.operation == "plan_landmarks"]
        if verdicts[-1].decision == "accepted":
            (only,) = planned
            given = [entry["position"] for entry in (only.arguments or {})["landmarks"]]
            expect(given == [list(map(float, point)) for point in points], f"The plan is {given}; {points} were sent.")
        else:
            expect(verdicts[-1].decision == "rejected" and not planned, f"The series was {verdicts[-1].decision}.")
        expect(impairment.counted["overtaken"] > 0, "No datagram overtook another one: choose another seed.")
        await planner.reinitiate()
        row = cell.last_row()
        await _send_at_once(planner, [("session_reinitxx", ())] * COMMANDS_SENT)
        done = _check_once(cell, row, COMMANDS_SENT, "toolplan")
        out_of_order = await _out_of_order(cell, planner)
        control = (await _send_at_once(cell.planner, sent))[-1]
        expect(control.decision == "accepted", f"In order the series was {control.decision}: {control.reason}.")
    return Evidence(
        "the series whole or refused; single commands exactly once",
        {"decision": verdicts[-1].decision, "reason": verdicts[-1].reason, "commands": done, **impairment.counted},
        took_place={"done_after_one_sent_later": out_of_order},
        control_kind="without_fault",
        control={"in_order": control.decision},
    )


async def _send_at_once(planner: Planner, sent: Sequence[tuple[str, tuple[Value, ...]]]) -> list[PlannerVerdict]:
    """Send commands without waiting for each other, and return their verdicts in the order of sending."""
    return await asyncio.gather(*(planner.command(name, *values) for name, values in sent))


async def _out_of_order(cell: RunningCell, planner: Planner) -> int:
    """Return how many of numbered commands were decided right after one that was sent later, by the journal's rows.

    Nothing is planned, so they are refused, and change nothing.
    """
    row = cell.last_row()
    await _send_at_once(planner, [("img_dig_digitize", (index,)) for index in range(COMMANDS_SENT)])
    decided = [entry for entry in cell.rows(row) if entry.operation == "digitize_one" and entry.verdict is not None]
    indices = [int((entry.arguments or {})["index"]) for entry in decided]
    return sum(later < earlier for earlier, later in itertools.pairwise(indices))


@fault("N4", how=PROXY)
async def answers_take_half_a_second(lab: Lab) -> Evidence:
    """With half a second each way every command is done once, even if its sender has given up waiting."""
    impairment = InjectedImpairment(seed=lab.seed, delay=0.5)
    async with lab.cell() as cell, _proxied(cell, impairment) as planner:
        control = await cell.planner.command("session_reinitxx", timeout=IMPATIENT)
        row = cell.last_row()
        given_up = 0
        started = time.time()
        for number in range(6):
            try:
                await planner.command("session_reinitxx", timeout=IMPATIENT if number % 2 else 10.0)
            except UnknownOutcomeError:
                given_up += 1
        expect(given_up == 3, f"{given_up} of 3 impatient commands ended in a typed timeout.")
        await _until_rows(cell, row, 6, "toolplan")
        _check_once(cell, row, 6, "toolplan")
        late = next(entry.wall for entry in cell.rows(row) if _is_outcome(entry, "toolplan")) - started
        expect(late >= impairment.delay, f"The first command was done {late:.3f} s after it was sent.")
    return Evidence(
        "exactly once, or a typed timeout",
        {"timeouts": given_up, **impairment.counted},
        took_place={"first_done_after_s": round(late, 3)},
        control_kind="without_fault",
        control={"as_impatient_without_the_delay": control.decision},
    )


@fault("N5", how="raw datagrams")
async def an_old_buffer_completes_nothing(lab: Lab) -> Evidence:
    """After a long datagram comes the beginning of the same one, cut at every byte."""
    long = b"target_tslxxxxxx_0.101_0.202_0.303;"
    async with lab.cell() as cell:
        cuts = [piece for end in range(1, len(long)) for piece in (b"adjust_tranxxxxx_0.101_0.202_0.303;", long[:end])]
        details = await refused_all(cell, cuts)
        whole = await send_accepted(cell, b"target_rotxxxxxx_0.0_0.0_0.0_1.0_#50;", long[:-1] + b"_#51;")
        await cell.planner.reinitiate()
    return _refused_and_taken(details, {"whole": whole})


@fault("N6", how="raw datagrams")
async def no_terminator_and_oversize(lab: Lab) -> Evidence:
    """Datagrams without an end, with two ends, and of up to 60,000 bytes are refused."""
    whole = b"session_reinitxx"
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        wrong = [whole, whole + b";;", whole + b";" + whole + b";", whole + b"\0;", b";", b"\xff" * 300]
        wrong += [whole + b"_" * size + b";" for size in (256, 1500, 9000, 60_000)]
        details = await refused_all(cell, wrong)
        return _refused_and_taken(details, {"whole": await send_accepted(cell, whole + b"_#61;")})


@fault("N7", how="raw datagrams of two planners")
async def rotation_and_translation_of_two_plans(lab: Lab) -> Evidence:
    """A translation without its rotation, or long after it, is refused; so is an approach by the rest."""
    turned, moved = b"target_rotxxxxxx_0.0_0.0_0.0_1.0", b"target_tslxxxxxx_0.01_0.02_0.11"
    async with lab.cell() as cell, raw_socket(cell.ready.links["planner"]) as other:
        await register(cell.client)
        before = await cell.client.state()
        other.attack(turned + b";")
        await other.fence()
        details = await refused_all_with_reasons(cell, [moved + b"_#77;"], {"no_rotation"})
        other.attack(turned + b";")
        await asyncio.sleep(1.2)
        other.attack(moved + b"_#78;")
        late = b"".join(await _answers(other))
        expect(b"rotation_too_old" in late, f"The late translation was answered {late!r}.")
        expect((await cell.client.state()).plan == before.plan, "The planned pose has changed.")
        approach = await cell.planner.command("execute_motionxx")
        expect(approach.decision == "rejected", f"The approach was {approach.decision}.")
        control = await send_accepted(cell, turned + b"_#178;", moved + b"_#179;")
        pose = plan().poses[0]
        await cell.planner.plan_pose(pose.position, pose.quat_xyzw)
    return Evidence(
        "refused with their reasons",
        {**details, "late": late.decode(), "approach": approach.reason},
        took_place={"refused": details["refused"]},
        control_kind="without_fault",
        control={"of_one_plan_in_time": control},
    )


@fault("N8", how="raw datagrams")
async def a_series_with_gaps(lab: Lab) -> Evidence:
    """A series with missing or repeated landmarks, or with one outside the announced number, is refused."""
    point = b"_0.01_0.02_0.03"
    first = b"img_fid_pntxxxxx_00" + point + b";"
    series = {
        "a landmark is missing": ("incomplete_series", [b"img_fid_numxxxxx_03;", first]),
        "a landmark comes twice": ("no_series", [b"img_fid_numxxxxx_02;", first, first]),
        "one more than announced": ("no_series", [b"img_fid_numxxxxx_01;", b"img_fid_pntxxxxx_01" + point + b";"]),
    }
    async with lab.cell() as cell:
        await digitize_landmarks(cell.client)
        details: dict[str, Any] = {}
        for number, (name, (code, datagrams)) in enumerate(series.items()):
            end = f"img_fid_lastrecv_#{1000 + number};".encode()
            details[name] = await refused_all_with_reasons(cell, [*datagrams, end], {code})
        before = cell.last_row()
        await cell.planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
        (control,) = (row for row in cell.rows(before) if row.operation == "plan_landmarks" and row.kind == "outcome")
    return Evidence(
        "refused with their reasons",
        details,
        took_place={name: refused["refused"] for name, refused in details.items()},
        control_kind="without_fault",
        control={"a_whole_series": control.verdict.decision if control.verdict is not None else ""},
    )


@fault("N14", how="strace: recvmsg of the daemon fails", needs=NEEDS)
async def a_socket_error(lab: Lab) -> Evidence:
    """The kernel reports errors at the receiving socket; the receiver continues."""
    failed: dict[str, int] = {}
    async with lab.daemon() as cell:
        control = await cell.planner.command("stop_visualizexx", timeout=PATIENCE)
        for error in ("ECONNREFUSED", "ENETDOWN", "ENOBUFS"):
            action = f"error={error}:when=1"
            async with injected(cell.process.pid, RECEIVING, action, threads=False) as tampered:
                with suppress(UnknownOutcomeError):
                    await cell.planner.command("stop_visualizexx", timeout=1.0)
            expect(tampered.calls > 0, f"No call was answered with {error}.")
            verdict = await cell.planner.command("stop_visualizexx", timeout=PATIENCE)
            expect(verdict.decision == "accepted", f"After {error} it was {verdict.decision}.")
            failed[error] = tampered.calls
        await cell.planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
        expect(await state(cell.client, "registration") == "100", "The planner's link is dead.")
    return Evidence(
        "the receiver continues",
        took_place=failed,
        control_kind="without_fault",
        control={"without_an_error": control.decision},
    )


def _refused_and_taken(details: dict[str, Any], control: dict[str, str]) -> Evidence:
    return Evidence(
        "refused, nothing changed",
        details,
        took_place={"refused": details["refused"]},
        control_kind="without_fault",
        control=control,
    )


async def refused_all_with_reasons(cell: RunningCell, datagrams: Sequence[bytes], codes: set[str]) -> dict[str, Any]:
    """Send datagrams as `refused_all`; every one with an id must be answered with one of the codes.

    Args:
        cell: Cell whose planner link receives them.
        datagrams: Datagrams in the order of sending; one of them is refused.
        codes: Permitted reason codes.

    Returns:
        Details for the report.

    Raises:
        Unmet: The response was not as required.
    """
    details = await refused_all(cell, datagrams, refusals=1)
    for answer in details["answers"]:
        expect(any(code in answer for code in codes), f"The answer was {answer}; expected one of {sorted(codes)}.")
    expect(bool(details["answers"]), "There was no answer.")
    return details


async def _answers(raw: Any) -> list[bytes]:
    answers: list[bytes] = await raw.fence()
    return answers


class _Sent(NamedTuple):
    """Commands that were sent one after the other.

    Attributes:
        done: Number of commands by the journal.
        arrived: Number of datagrams that the daemon counts.
        repeated: Number of commands that their sender repeated because no answer came.
    """

    done: int
    arrived: int
    repeated: int


async def _check_exactly_once(
    lab: Lab, impairment: InjectedImpairment, counted: str, measured: Callable[[_Sent], dict[str, int]]
) -> Evidence:
    """Send commands over an impaired link: each is done exactly once, and its verdict comes; then over a good link."""
    async with lab.cell() as cell:
        async with _proxied(cell, impairment) as planner:
            sent = await _send_one_by_one(cell, planner)
            await planner.plan_landmarks([landmark.position for landmark in plan().landmarks])
            expect(impairment.counted[counted] > 0, f"Nothing was {counted}: choose another seed.")
        async with _proxied(cell, InjectedImpairment()) as planner:
            control = await _send_one_by_one(cell, planner)
    return Evidence(
        "every command exactly once",
        {**sent._asdict(), **impairment.counted},
        took_place=measured(sent),
        control_kind="without_fault",
        control={"done_in_good_weather": control.done, "arrived_in_good_weather": control.arrived},
    )


async def _send_one_by_one(cell: RunningCell, planner: Planner) -> _Sent:
    row, before = cell.last_row(), (await cell.client.health()).datagrams
    clock = asyncio.get_running_loop().time
    repeated = 0
    for _ in range(COMMANDS_SENT):
        started = clock()
        await planner.command("session_reinitxx", timeout=30.0)
        repeated += clock() - started >= REPEAT_AFTER
    arrived = (await cell.client.health()).datagrams - before
    return _Sent(_check_once(cell, row, COMMANDS_SENT, "toolplan"), arrived, repeated)


@asynccontextmanager
async def _proxied(cell: RunningCell, impairment: InjectedImpairment) -> AsyncIterator[Planner]:
    async with udp_proxy(cell.ready.links["planner"], impairment) as address, await Planner.open(*address) as planner:
        yield planner


def _check_once(cell: RunningCell, row: int, commands: int, branch: str) -> int:
    """Check that the commands sent since a row have one outcome each."""
    outcomes = [entry for entry in cell.rows(row) if _is_outcome(entry, branch)]
    ids = Counter((entry.source, entry.command_id) for entry in outcomes)
    if len(ids) != commands or any(count > 1 for count in ids.values()):
        raise Unmet(f"{commands} commands were sent, the journal has {len(outcomes)} outcomes of {len(ids)} commands.")
    return len(ids)


def _is_outcome(entry: JournalRow, branch: str) -> bool:
    return entry.kind == "outcome" and entry.branch == branch


async def _until_rows(cell: RunningCell, row: int, outcomes: int, branch: str) -> None:
    def complete() -> bool:
        return sum(_is_outcome(entry, branch) for entry in cell.rows(row)) >= outcomes

    await until_true(complete, f"The journal has no {outcomes} outcomes")
