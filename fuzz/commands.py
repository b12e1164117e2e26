"""String commands of the gateway: a datagram is parsed or refused, and a parsed one can be formatted again.

python -m fuzz.commands -max_total_time=60
"""

from __future__ import annotations

from fuzz.running import instrumented, run

with instrumented("pcmrs.gateway"):
    from pcmrs.errors import PayloadError
    from pcmrs.gateway.commands import COMMANDS
    from pcmrs.gateway.grammar import MAX_BYTES, format_command, parse, parse_tool_points

NAMES = sorted(COMMANDS)


def one(data: bytes) -> None:
    """Parse a datagram; the first byte may select a command, so that its tokens are tried, too."""
    datagram = NAMES[data[0] % len(NAMES)].encode() + data[1:] if data[:1] > b"\x20" else data[1:]
    try:
        if parse_tool_points(datagram) is not None:
            return
        request = parse(datagram)
    except PayloadError:
        return
    assert len(datagram) <= MAX_BYTES
    try:
        again = format_command(request.spec.name, *request.values, client_id=request.id)
    except PayloadError:  # a number may take more digits than it was given
        assert len(datagram) > MAX_BYTES / 2
        return
    assert parse(again) == request


if __name__ == "__main__":
    run(one)
