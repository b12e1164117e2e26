"""Grammar of the datagrams and replies: every datagram parses to its values, or is malformed; a reply can be parsed."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pcmrs.errors import PayloadError
from pcmrs.gateway.commands import COMMANDS, Second, Spec, TokenType, Value
from pcmrs.gateway.grammar import (
    MAX_BYTES,
    NO_DATA,
    CommandOutcome,
    format_command,
    of_verdict,
    parse,
    parse_tool_points,
)
from pcmrs.messages import Verdict
from pcmrs.planner import parse_reply

_TOKENS: dict[TokenType, st.SearchStrategy[Value]] = {
    TokenType.COUNT: st.integers(0, 999),
    TokenType.NUMBER: st.floats(allow_nan=False, allow_infinity=False),
    TokenType.PATH: st.from_regex(r"[a-zA-Z0-9_/.\-]{0,99}[a-z]", fullmatch=True),
}


@st.composite
def _commands(draw: st.DrawFn) -> tuple[Spec, tuple[Value, ...], str | None]:
    spec = draw(st.sampled_from(list(COMMANDS.values())))
    values = tuple(draw(_TOKENS[kind]) for kind in spec.payload)
    return spec, values, draw(st.none() | st.from_regex(r"[0-9]{1,10}", fullmatch=True))


@given(_commands())
def test_formatted_command_parses_to_the_same_values(command: tuple[Spec, tuple[Value, ...], str | None]) -> None:
    spec, values, client_id = command
    request = parse(format_command(spec.name, *values, client_id=client_id))
    assert (request.spec, request.values, request.id) == command


@given(st.binary(max_size=300) | st.sampled_from(sorted(COMMANDS)).flatmap(
    lambda name: st.text("_#;|0123456789.e+-nainfx", max_size=40).map(lambda rest: (name + rest).encode())
))  # fmt: skip
@example(b"")
@example(b"img_fid_numxxxxx_" + "\u0663".encode() + b";")
def test_bytes_parse_or_are_malformed_and_nothing_else(data: bytes) -> None:
    for read in (parse, parse_tool_points):
        with contextlib.suppress(PayloadError):
            read(data)


@pytest.mark.parametrize("token", ["1e-3", "-.5", "+2.", "0.000000000000001", "7"])
def test_decimal_numbers_are_taken(token: str) -> None:
    assert parse(f"target_tslxxxxxx_{token}_0_0;".encode()).values[0] == float(token)


@pytest.mark.parametrize("token", ["nan", "inf", "-inf", "1e999", "1_000", "0x1", "", " 1", "1e", ".", "--1", "1,5"])
def test_other_numbers_are_refused(token: str) -> None:
    with pytest.raises(PayloadError):
        parse(f"target_tslxxxxxx_{token}_0_0;".encode())


@pytest.mark.parametrize(
    "text",
    [
        "execute_motionxx",  # no terminator
        "execute_motionxx;;",  # more than the terminator
        "execute_motionxx; ",
        "execute_motionxx;execute_confirmx;",
        "execute_motionxx_1;",  # arity
        "execute_motionxxx;",
        "target_tslxxxxxx_1_2;",
        "target_tslxxxxxx_1_2_3_4;",
        "img_dig_digitize_-1;",
        "img_dig_digitize_1.0;",
        "execute_motionxx_#;",  # id
        "execute_motionxx_#12345678901;",
        "execute_motionxx_#1_#2;",
        "icp_registerxxxx_;",
        "magic_close_byte;",  # unknown
        "execute_motionxx;|peer|1|" + "0" * 31,  # no signature
    ],
)
def test_the_whole_grammar_is_checked(text: str) -> None:
    with pytest.raises(PayloadError):
        parse(text.encode())


def test_a_signature_is_no_part_of_a_command() -> None:
    with pytest.raises(PayloadError, match="follows the terminator"):
        parse(b"execute_motionxx;|planner|7|" + b"0123456789abcdef" * 2)


def test_a_path_is_opaque() -> None:
    request = parse(b"icp_registerxxxx_/a_b/c d_1.stl_#5;")
    assert (request.values, request.id) == (("/a_b/c d_1.stl",), "5")


@pytest.mark.parametrize(("size", "fits"), [(MAX_BYTES, True), (MAX_BYTES + 1, False)])
def test_the_length_is_limited(size: int, fits: bool) -> None:
    datagram = b"icp_registerxxxx_".ljust(size - 1, b"a") + b";"
    if fits:
        parse(datagram)
    else:
        with pytest.raises(PayloadError, match="257 bytes, the limit is 256"):
            parse(datagram)


@pytest.mark.parametrize(
    ("name", "values", "client_id"),
    [
        ("rob_conn_onxxxxx", (1.0,), None),
        ("target_tslxxxxxx", (0.0, 0.0, float("inf")), None),
        ("target_tslxxxxxx", (0.0, 0.0), None),
        ("img_fid_numxxxxx", (-1,), None),
        ("no_command_at_al", (), None),
        ("rob_conn_onxxxxx", (), "12345678901"),
        ("rob_conn_onxxxxx", (), "a"),
    ],
)
def test_command_the_gateway_would_refuse_is_not_formatted(
    name: str, values: tuple[Value, ...], client_id: str | None
) -> None:
    with pytest.raises(PayloadError):
        format_command(name, *values, client_id=client_id)


@pytest.mark.parametrize("numbers", ["", "_", "1_2_3_4_5", "1_2_3_4_5_6_7", "1_2_3_4_5_x", "1_2_3_4_5_1e999"])
def test_a_tool_pose_has_six_numbers(numbers: str) -> None:
    with pytest.raises(PayloadError):
        parse_tool_points(f"__msg_toolpose_{numbers}".encode())


@given(
    st.sampled_from(["rejected", "failed"]),
    st.from_regex(r"[0-9]{1,10}", fullmatch=True),
    st.from_regex(r"[a-z]+(_[a-z]+)*", fullmatch=True),
)
def test_a_refusal_stays_parseable_whatever_its_reason(decision: str, client_id: str, reason: str) -> None:
    outcome = CommandOutcome(decision, "tool_plan", "in_air", reason)  # type: ignore[arg-type]
    back_id, verdict = parse_reply(outcome.reply(client_id).encode())
    assert (back_id, verdict.decision, verdict.branch, verdict.state, verdict.reason) == (
        client_id, decision, "tool-plan", "in-air", reason,
    )  # fmt: skip


@given(st.lists(st.floats(-1e3, 1e3), max_size=9))
def test_results_follow_an_acceptance(numbers: list[float]) -> None:
    _, verdict = parse_reply(
        CommandOutcome("accepted", "placement", "placed", numbers=tuple(numbers)).reply("1").encode()
    )
    assert verdict.results == pytest.approx(numbers, rel=1e-5)


def test_a_refused_registration_never_shows_numbers() -> None:
    for refused in ("rejected", "failed"):
        outcome = CommandOutcome(refused, "registration", "110", "residual_too_large", (2.3,))
        assert outcome.second(Second.RESIDUAL) == NO_DATA
    assert CommandOutcome("accepted", "registration", "111", numbers=(2.300912,)).second(Second.RESIDUAL) == "2.300912"


def test_unknown_outcome_is_reported_as_unknown() -> None:
    unknown = Verdict(
        id="1", branch="placement", operation="approach", decision="unknown", state="unknown", sequence=1,
        result={"residual": 0.001},
    )  # fmt: skip
    assert of_verdict(unknown).reply("7") == "7_failed_placement_unknown_outcome_unknown;"
