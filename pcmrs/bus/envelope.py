"""The command envelope: what is put or asked on ``cmd/<user>/<branch>/<operation>``."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from msgspec import Meta, field

from pcmrs.bus.codec import reason_from
from pcmrs.bus.keys import split_command_key
from pcmrs.errors import PcmrsError
from pcmrs.messages import Command, Message, Verdict
from pcmrs.messages.identity import Role


class Envelope(Message, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command without its address; every field may be left out.

    Attributes:
        id: Unique per user; a repeat runs nothing. Made up when it is missing.
        sent: Unix seconds; refused when it lies in the future.
        ttl: Seconds after `sent` beyond which the command is refused as expired; needs `sent`.
        arguments: Of the operation.
    """

    max_bytes: ClassVar[int] = 64 * 1024

    id: Annotated[str, Meta(min_length=1, max_length=128)] | None = None
    sent: float | None = None
    ttl: Annotated[float, Meta(ge=0)] | None = None
    arguments: dict[str, Any] = field(default_factory=dict)


def command_from(key: str, envelope: Envelope, role_of: Callable[[str], Role]) -> Command:
    """The command that an envelope on a relative key ``cmd/*/*/*`` stands for, with the role of its user.

    Raises:
        PayloadError: A part of the key is no name.
        AccessError: The user may not take part in this cell.
    """
    user, branch, operation = split_command_key(key)
    return Command(
        id=envelope.id or uuid.uuid4().hex,
        branch=branch,
        operation=operation,
        source=f"bus:{user}",
        user=user,
        role=role_of(user),
        arguments=envelope.arguments,
        sent=envelope.sent,
        ttl=envelope.ttl,
    )


def refusal(key: str, error: PcmrsError) -> Verdict:
    """The verdict on a command that never reached the dispatcher: it has no id, state or sequence."""
    _, _, branch, operation = key.split("/")
    return Verdict(
        id="",
        branch=branch,
        operation=operation,
        decision="rejected",
        state="",
        sequence=0,
        reason=reason_from(error),
    )
