"""Encoding and decoding of messages: MessagePack, or JSON text that people type.

A payload whose first non-space byte is ``{`` is JSON text, an empty one is a message without fields, and all others
are MessagePack. The declared encoding is ignored, because command-line tools do not declare any.

An error crosses the bus as a `Reason` and is raised again where the request was made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable
from typing import Any, Final, TypeVar, cast

import msgpack
import msgspec

from pcmrs.bus._closed_decoder import INTEGER_LIMIT, closed_decoder
from pcmrs.bus._closed_encoder import encode_closed, is_closed
from pcmrs.errors import DeviceError, PayloadError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, Message, Reason, Verdict

T = TypeVar("T")

MAX_BYTES: Final = 16 * 1024 * 1024
"""Largest payload of a message whose type does not set its own `max_bytes`."""

MAX_DEPTH: Final = 32
"""Greatest nesting of lists and maps; far below Python's recursion limit, which handlers of a message rely on."""


class Empty(Message, frozen=True, kw_only=True):
    """A request without fields."""


def is_text(payload: bytes) -> bool:
    """Return True if `payload` is JSON text or empty: its sender gets the reply as JSON text, too."""
    stripped = payload.lstrip()
    return not stripped or stripped.startswith(b"{")


def pack(message: Any) -> bytes:
    """Encode a message as MessagePack.

    Raises:
        PayloadError: The message holds a value that MessagePack or JSON has no type for.
    """
    return _encode(message, _packed)


def pack_text(message: Any) -> bytes:
    """Encode a message as JSON text.

    Raises:
        PayloadError: The message holds a value that MessagePack or JSON has no type for.
    """
    return _encode(message, _as_text)


def _encode(message: Any, encode: Callable[[Any], bytes]) -> bytes:
    try:
        return encode(message)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise PayloadError(
            f"A {type(message).__name__} cannot be sent: {error}. Use numbers, text, lists and maps only."
        ) from error


def _packed(message: Any) -> bytes:
    if is_closed(cast(Hashable, type(message))):
        return encode_closed(message)
    return cast(bytes, msgpack.packb(msgspec.to_builtins(message)))


def _as_text(message: Any) -> bytes:
    return msgspec.json.encode(msgspec.to_builtins(message))


def unpack(payload: bytes, kind: type[T]) -> T:
    """Decode a message from MessagePack or JSON text.

    Args:
        payload: Bytes as they were received.
        kind: Type of the message. Its `max_bytes`, or else `MAX_BYTES`, limits the length.

    Raises:
        PayloadError: The payload is too long, nested too deeply, neither MessagePack nor JSON, not of `kind`, or holds
            a number that is not finite or has more than 64 bits.
    """
    limit = getattr(kind, "max_bytes", MAX_BYTES)
    if len(payload) > limit:
        raise PayloadError(f"{len(payload)} bytes are too long: at most {limit}.", length=len(payload), limit=limit)
    decode = closed_decoder(cast(Hashable, kind))
    if decode is not None and not is_text(payload) and (message := decode(payload)) is not None:
        return cast(T, message)
    # JSON text, a type with open parts, or a payload to refuse with its reason
    value = _decode(payload)
    _require_plain(value)
    return convert(value, kind)


def convert(value: Any, kind: type[T]) -> T:
    """Convert decoded fields to a message.

    Args:
        value: Fields as plain data.
        kind: Type of the message.

    Raises:
        PayloadError: The fields do not fit the type.
    """
    try:
        return msgspec.convert(value, kind)
    except (msgspec.ValidationError, RecursionError) as error:
        raise PayloadError(f"Not a {kind.__name__}: {error}.", kind=kind.__name__) from error


def convert_event(fields: dict[str, Any]) -> Verdict | DeviceEvent:
    """Convert the decoded fields of a message on ``state/event``. Raises `PayloadError`."""
    return convert(fields, Verdict) if "decision" in fields else convert(fields, DeviceEvent)


def _decode(payload: bytes) -> Any:
    try:
        if is_text(payload):
            return msgspec.json.decode(payload) if payload.strip() else {}
        return msgpack.unpackb(payload)
    except (ValueError, RecursionError, msgspec.DecodeError, msgpack.UnpackException) as error:
        # msgpack's FormatError and StackError carry no text.
        why = str(error) or type(error).__name__
        raise PayloadError(f"Neither MessagePack nor JSON text: {why}.") from error


def _require_plain(value: Any) -> None:
    """Check all values level by level, not by recursion: the sender chooses the depth."""
    level = [value]
    for _ in range(MAX_DEPTH + 1):
        level = [part for item in level for part in _parts(item)]
        if not level:
            return
    raise PayloadError(
        f"A value is nested in more than {MAX_DEPTH} lists and maps; send flatter data.", limit=MAX_DEPTH
    )


def _parts(item: Any) -> Iterable[Any]:
    """Return the items of a list or map, nothing for other values. Raises `PayloadError` if it is no plain data."""
    if isinstance(item, dict):
        if not all(isinstance(key, str) for key in item):
            raise PayloadError("A map has a key that is not text; use text for keys.")
        return item.values()
    if isinstance(item, list):
        return item
    if isinstance(item, float):
        if not math.isfinite(item):
            raise PayloadError(f"{item} is not a finite number; send finite numbers only.", value=str(item))
    elif isinstance(item, int):
        if not -INTEGER_LIMIT <= item < INTEGER_LIMIT:
            raise PayloadError("An integer has more than 64 bits; send it as text.")
    elif not isinstance(item, str | bytes | None):
        raise PayloadError(f"{type(item).__name__} cannot be sent on this bus; use numbers, text, lists and maps.")
    return ()


def reason_from(error: PcmrsError) -> Reason:
    """Return an error as data, with the code that a program may match on."""
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    return Reason(code=code, text=error.text, fields=error.fields)


def busy(limit: int) -> RefusalError:
    """Return the refusal of a message that found a queue of `limit` places full."""
    return RefusalError("busy", f"More than {limit} messages wait; send it again later.", limit=limit)


def error_from(payload: bytes) -> PcmrsError:
    """Return the error that an error reply stands for.

    Returns:
        `DeviceError` with the sent code in its field ``reason``; `UnknownOutcomeError` if the outcome is unknown to the
        other side, too, or if the bus itself made the reply, as at a timeout.
    """
    try:
        reason = unpack(payload, Reason)
    except PayloadError:
        return UnknownOutcomeError(f"The bus gave up: {payload.decode(errors='replace')}.")
    text = (
        reason.text
        or f"The request failed ({reason.code or 'no code'}), and the reply does not say why: see the log there."
    )
    if reason.code == UnknownOutcomeError.code:
        return UnknownOutcomeError(text, values=reason.fields)
    return DeviceError(text, reason=reason.code, values=reason.fields)
