"""Signed commands and answers, over UDP and TCP: without the key nothing is accepted, and a stream ends or continues.

python -m fuzz.signed -max_total_time=60
"""

from __future__ import annotations

from contextlib import suppress

from fuzz.running import instrumented, pieces, run

with instrumented("pcmrs.gateway"):
    from pcmrs.errors import PayloadError
    from pcmrs.gateway.signing import Signer, sign_answer, split
    from pcmrs.gateway.tcp import Frames

KEY = bytes(range(32))


def one(data: bytes) -> None:
    """Split and check a signed datagram, whose tag no random input has."""
    kind, rest = data[:1], data[1:]
    if kind < b"\x55":
        signed = split(rest)
        if signed is not None:
            assert b"%s|%s|%d" % (signed.command, signed.peer.encode(), signed.counter) == signed.covered
            assert rest == signed.covered + b"|" + signed.tag
            assert not signed.holds(KEY[::-1])
    elif kind < b"\xaa":
        frames = Frames()
        with suppress(PayloadError):
            for piece in pieces(rest):
                for frame in frames.feed(piece):
                    assert frame.count(b";") == 1
                assert len(frames.unfinished) < 512 + len(piece)
    else:
        signer = Signer("planner", KEY, lambda: 7, answers_signed=True)
        signer.sign(b"stop_now_xxxxxxx;")
        with suppress(PayloadError):
            assert rest == sign_answer("ack", "planner", 7, KEY).encode() or signer.check(rest) == b"no answer"


if __name__ == "__main__":
    run(one)
