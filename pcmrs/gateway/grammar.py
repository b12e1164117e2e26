"""Grammar of command datagrams and of the replies: bytes to command and back, checked as a whole, and outcome to text.

A datagram is ``<16 characters>[_<token>...][_#<id>];``, printable ASCII, at most 256 bytes. Numbers are decimal
(``-0.5``, ``1e-3``) and finite. The last token ``#<id>``, 1 to 10 digits, asks for a verdict reply; a path token
takes everything between, so a path cannot itself end in such a token. A signature behind the terminator is taken off
before: see `pcmrs.gateway.signing`.

Verdict reply: ``<id>_accepted_<branch>_<state>[_<number>...];`` or ``<id>_rejected_<branch>_<state>_<reason>;`` or the
same with ``failed``. ``_`` inside a branch or state is written ``-``; the reason is everything after the fourth
separator and may itself hold ``_``. An unknown outcome is ``failed`` with the reason ``outcome_unknown``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pcmrs.errors import PayloadError, UnknownOutcomeError
from pcmrs.gateway.commands import COMMANDS, Second, Spec, TokenType, Value

if TYPE_CHECKING:
    # Only for annotations: a planner shares this grammar and must not load the messages of the bus for it.
    from pcmrs.messages import Verdict

MAX_BYTES = 256
NAME_LENGTH = 16
TOOL_POINTS_PREFIX = "__msg_toolpose_"
NO_DATA = "no_data_returned;"
"""Second datagram of a command that has no result."""

_COUNT = re.compile(r"[0-9]{1,3}")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_ID = re.compile(r"_#([0-9]{1,10})$")
_PRINTABLE = re.compile(rb"[\x20-\x7e]*")


@dataclass(frozen=True, slots=True)
class StringCommand:
    """A well-formed command: its values in the order of `spec.payload`, and the client's id if it gave one."""

    spec: Spec
    values: tuple[Value, ...] = ()
    id: str | None = None

    def repeats(self, other: StringCommand) -> bool:
        """Return whether this has the name and the values of another command."""
        return (self.spec.name, self.values) == (other.spec.name, other.values)


def parse(datagram: bytes) -> StringCommand:
    """Parse one datagram.

    Raises:
        PayloadError: The datagram breaks the grammar or names no command.
    """
    body = _command_text(_text(datagram))
    name, payload = body[:NAME_LENGTH], body[NAME_LENGTH:]
    spec = COMMANDS.get(name)
    if spec is None:
        raise PayloadError(f"{name!r} is not a command; the name is the first 16 characters.", name=name)
    match = _ID.search(payload)
    client_id = match[1] if match else None
    tokens = _tokens(spec, payload[: match.start()] if match else payload)
    values = tuple(_value(kind, token, spec) for kind, token in zip(spec.payload, tokens, strict=True))
    return StringCommand(spec, values, client_id)


def may_become_command(beginning: bytes) -> bool:
    """Return whether further bytes could make a datagram of `beginning` that names a command; a whole one may be wrong.

    Args:
        beginning: First bytes of a datagram, or all of them.
    """
    if len(beginning) > MAX_BYTES or not _PRINTABLE.fullmatch(beginning):
        return False
    name = beginning[:NAME_LENGTH].decode("ascii")
    return name in COMMANDS or any(each.startswith(name) for each in COMMANDS)


def format_command(name: str, *values: Value, client_id: str | None = None) -> bytes:
    """Return the datagram of a command; `parse` returns exactly these values.

    Args:
        name: Name of the command, 16 characters.
        values: Values of its payload.
        client_id: Id for a verdict reply, 1 to 10 digits; None for none.

    Raises:
        PayloadError: The result would break the grammar.
    """
    tokens = [_token(value) for value in values]
    if client_id is not None:
        tokens.append(f"#{client_id}")
    try:
        datagram = ("_".join([name, *tokens]) + ";").encode("ascii")
    except UnicodeEncodeError:
        raise PayloadError(f"{name} {values!r} holds a character that is not ASCII.", name=name) from None
    parse(datagram)
    return datagram


def parse_tool_points(datagram: bytes) -> tuple[float, ...] | None:
    """Return the two points (x1, y1, z1, x2, y2, z2), mm, of a tool-pose message; None for another message.

    Raises:
        PayloadError: The message starts like one but does not hold six numbers.
    """
    if not datagram.startswith(TOOL_POINTS_PREFIX.encode()):
        return None
    tokens = _text(datagram)[len(TOOL_POINTS_PREFIX) :].split("_")
    if len(tokens) != 6:
        raise PayloadError(f"{TOOL_POINTS_PREFIX} takes 6 numbers, got {len(tokens)}.", count=len(tokens))
    return tuple(_number(token, TOOL_POINTS_PREFIX) for token in tokens)


def _text(datagram: bytes) -> str:
    if len(datagram) > MAX_BYTES:
        raise PayloadError(
            f"The datagram has {len(datagram)} bytes, the limit is {MAX_BYTES}.", size=len(datagram), limit=MAX_BYTES
        )
    if not _PRINTABLE.fullmatch(datagram):
        raise PayloadError(f"The datagram {datagram[:40]!r} holds bytes that are not printable ASCII.")
    return datagram.decode("ascii")


def _command_text(text: str) -> str:
    """Everything before the terminator."""
    body, terminator, rest = text.partition(";")
    if not terminator:
        raise PayloadError(f"{text[:40]!r} has no terminator; end every command with ';'.")
    if rest:
        raise PayloadError(f"{rest[:40]!r} follows the terminator; send one command per datagram.", rest=rest)
    return body


def _tokens(spec: Spec, payload: str) -> list[str]:
    if spec.payload == (TokenType.PATH,):
        tokens = [payload[1:]] if payload.startswith("_") and len(payload) > 1 else []
    elif payload and not payload.startswith("_"):
        raise PayloadError(f"{spec.name} is followed by {payload[:40]!r}; tokens start with '_'.", name=spec.name)
    else:
        tokens = payload.split("_")[1:]
    if len(tokens) != len(spec.payload):
        raise PayloadError(
            f"{spec.name} takes {len(spec.payload)} tokens, got {len(tokens)}.",
            name=spec.name,
            expected=len(spec.payload),
            got=len(tokens),
        )
    return tokens


def _value(kind: TokenType, token: str, spec: Spec) -> Value:
    if kind is TokenType.PATH:
        return token
    if kind is TokenType.NUMBER:
        return _number(token, spec.name)
    if not _COUNT.fullmatch(token):
        raise PayloadError(f"{spec.name} takes an index of 1 to 3 digits, got {token[:40]!r}.", token=token)
    return int(token)


def _number(token: str, name: str) -> float:
    number = float(token) if _NUMBER.fullmatch(token) else math.nan
    if not math.isfinite(number):
        raise PayloadError(f"{name} takes finite decimal numbers, got {token[:40]!r}.", name=name, token=token)
    return number


def _token(value: Value) -> str:
    if isinstance(value, int):
        return f"{value:02d}"
    return repr(value) if isinstance(value, float) else value


@dataclass(frozen=True, slots=True)
class CommandOutcome:
    """Outcome of a command.

    Attributes:
        reason: Code of the reason; None if accepted.
        numbers: Results in the units of the wire.
    """

    decision: Literal["accepted", "rejected", "failed"]
    branch: str
    state: str
    reason: str | None = None
    numbers: tuple[float, ...] = ()

    def reply(self, client_id: str) -> str:
        """Return the verdict reply to the command `client_id`."""
        head = [client_id, self.decision, self.branch.replace("_", "-"), self.state.replace("_", "-")]
        tail = [self.reason] if self.reason else [f"{number:.6g}" for number in self.numbers]
        return "_".join([*head, *tail]) + ";"

    def second(self, kind: Second) -> str:
        """Return the second datagram for clients without verdict replies: numbers if accepted."""
        if self.decision != "accepted" or not self.numbers:
            return NO_DATA
        if kind is Second.RESIDUAL:
            return f"{self.numbers[0]:.6f}"
        return "".join(f"{number:.6f}_" for number in self.numbers)


def of_verdict(verdict: Verdict) -> CommandOutcome:
    """Return the outcome of a dispatcher's verdict."""
    if verdict.decision == "accepted":
        return CommandOutcome("accepted", verdict.branch, verdict.state, numbers=_numbers(verdict.result or {}))
    if verdict.decision == "unknown":
        return CommandOutcome("failed", verdict.branch, verdict.state, UnknownOutcomeError.code)
    code = verdict.reason.code if verdict.reason else verdict.decision
    return CommandOutcome(verdict.decision, verdict.branch, verdict.state, code)


def _numbers(result: dict[str, Any]) -> tuple[float, ...]:
    """Residual in mm; or the measured pose (m, ``xyzw``, image) with its errors in mm and degrees."""
    if "residual" in result:
        return (result["residual"] * 1e3,)
    if "measured" in result:
        measured = result["measured"]
        errors = (result["translation_error"] * 1e3, math.degrees(result["rotation_error"]))
        return (*measured["position"], *measured["quat_xyzw"], *errors)
    return ()
