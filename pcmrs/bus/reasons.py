"""Errors that cross the bus: as a `Reason` on the way out, raised again where the request was made."""

from __future__ import annotations

from pcmrs.bus.codec import unpack
from pcmrs.errors import DeviceError, PayloadError, PcmrsError, RefusalError, UnknownOutcomeError
from pcmrs.messages import Reason


def reason_from(error: PcmrsError) -> Reason:
    """The error as data, under the code that a program may match on."""
    code = error.refusal_code if isinstance(error, RefusalError) else error.code
    return Reason(code=code, text=error.text, fields=error.fields)


def busy(limit: int) -> RefusalError:
    """Refusal of a message for which a queue with so many places has none."""
    return RefusalError("busy", f"More than {limit} messages wait; send it again later.", limit=limit)


def error_from(payload: bytes) -> PcmrsError:
    """The error that an error reply stands for.

    Returns:
        `DeviceError` with the sent code in its field ``reason``; `UnknownOutcomeError` when the other side
        does not know either, or when the reply is the bus's own, as at a timeout.
    """
    try:
        reason = unpack(payload, Reason)
    except PayloadError:
        return UnknownOutcomeError(f"The bus gave up: {payload.decode(errors='replace')}.")
    if reason.code == UnknownOutcomeError.code:
        return UnknownOutcomeError(reason.text, values=reason.fields)
    return DeviceError(reason.text, reason=reason.code, values=reason.fields)
