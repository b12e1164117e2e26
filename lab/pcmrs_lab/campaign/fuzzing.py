"""Datagrams that are nearly commands: made by the grammar, bent at one place, or random."""

from __future__ import annotations

import random

from pcmrs.gateway.commands import COMMANDS, Action, Kind, Spec
from pcmrs.gateway.grammar import NAME_LENGTH

HARMLESS = (Action.STOP_TIP, Action.STOP_POSES)
"""What a whole and right datagram may ask for, so that nothing may change whatever is sent."""

RIGHT = {Kind.COUNT: "01", Kind.NUMBER: "0.1", Kind.PATH: "surface.ply"}
WRONG = {
    Kind.COUNT: ("1000", "-1", "+1", "٣", "1.0", "", "nan", "0x1"),
    Kind.NUMBER: ("nan", "-nan", "inf", "1e999", "-1e999", "1_000", "0x1p3", "+", ".", "1e", "١", "", "1,5", " 1"),
    Kind.PATH: ("", "a" * 300, "a;b", "\n", "é"),
}
"""A token of each kind, and what is none."""
SIGNATURE = b"|peer|1|" + b"0" * 32
STRAYS = (b"\0", b"\n", b"\xff", b";", b";;", b"_#", b"_#12345678901", b"quit", b"exit")


def datagram(generator: random.Random) -> bytes:
    """One datagram; it does not do anything to a cell, whatever its state."""
    kind = generator.random()
    if kind < 0.1:
        return generator.randbytes(generator.choice((0, 1, 16, 17, 255, 256, 257, 1400)))
    spec = generator.choice(list(COMMANDS.values()))
    if spec.payload and kind < 0.5:
        return _wrong(spec, generator)
    whole = _command(spec, [RIGHT[each] for each in spec.payload], generator)
    return whole if kind < 0.6 and spec.action in HARMLESS else _bent(whole, generator)


def _wrong(spec: Spec, generator: random.Random) -> bytes:
    """A command with one token that is none of its kind, one too few, or one too many."""
    tokens = [RIGHT[kind] for kind in spec.payload]
    place, way = generator.randrange(len(tokens)), generator.random()
    if way < 0.1:
        return _command(spec, tokens[:-1], generator)
    if way < 0.2 and spec.payload != (Kind.PATH,):
        return _command(spec, [*tokens, "0.1"], generator)
    tokens[place] = generator.choice(WRONG[spec.payload[place]])
    return _command(spec, tokens, generator)


def _command(spec: Spec, tokens: list[str], generator: random.Random) -> bytes:
    if generator.random() < 0.3:
        tokens = [*tokens, f"#{generator.randrange(10**9)}"]
    return ("_".join([spec.name, *tokens]) + ";").encode()


def _bent(whole: bytes, generator: random.Random) -> bytes:
    """The command with a fault in its name or behind its end: the grammar has no such command."""
    place, ways = generator.randrange(NAME_LENGTH), generator.randrange(7)
    if ways == 0:
        return whole[:place] + bytes([generator.choice(b"@~ \x00\xff")]) + whole[place + 1 :]
    if ways == 1:
        return whole[: generator.randrange(len(whole))].rstrip(b";")
    if ways == 2:
        return whole + generator.choice(STRAYS) + b"!"
    if ways == 3:
        return whole[:place] + whole[place + 1 :]
    if ways == 4:
        return whole + SIGNATURE
    if ways == 5:
        return whole[:NAME_LENGTH] + b"!" + whole[NAME_LENGTH:]
    return whole.replace(b";", b"") + b"_" * generator.randrange(300)
