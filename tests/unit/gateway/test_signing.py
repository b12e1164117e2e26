"""Signatures and keys: what a signature covers, that every client makes the same one, and which key files are taken."""

from __future__ import annotations

import ast
import importlib.util
import json
import shutil
import subprocess
from itertools import count
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError, PayloadError, RefusalError
from pcmrs.gateway.auth.peers import SignedPeer, authenticate
from pcmrs.gateway.grammar import MAX_BYTES, parse
from pcmrs.gateway.settings import PeerConfig
from pcmrs.gateway.signing import Signer, new_key, read_key, sign_answer, split
from pcmrs.testing.clock import ManualClock
from tests import ROOT

CLIENTS = ROOT / "clients"


VECTORS: list[dict[str, Any]] = json.loads((CLIENTS / "signature_vectors.json").read_text(encoding="ascii"))


_commands = st.from_regex(rb"[ -:<-~]{0,60};", fullmatch=True)


@pytest.fixture(scope="module")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("keys") / "planner.key"
    new_key(file)
    return file


def peers(key_file: Path, newest: int = 0) -> dict[str, SignedPeer]:
    """Two peers with the same key: a name, too, is covered by the tag."""
    config = PeerConfig(key_file=str(key_file))
    return {name: SignedPeer(name, config, newest, ManualClock()) for name in ("planner", "panel")}


def take(known: dict[str, SignedPeer], datagram: bytes) -> bool:
    """Whether a datagram is taken for signed by one of the peers."""
    signed = split(datagram)
    if signed is None:
        with pytest.raises(PayloadError):
            parse(datagram)  # nor is it a command without signature
        return False
    try:
        authenticate(known, signed)
    except RefusalError:
        return False
    return True


@given(_commands, st.integers(1, 10**19 - 1), st.integers(0), st.integers(0, 7))
@example(b"icp_registerxxxx_a;", 1, 18, 0)
def test_a_flipped_bit_anywhere_is_refused(key_file: Path, command: bytes, counter: int, place: int, bit: int) -> None:
    datagram = Signer("planner", read_key(key_file), lambda: counter).sign(command)
    flipped = bytearray(datagram)
    flipped[place % len(datagram)] ^= 1 << bit
    assert not take(peers(key_file), bytes(flipped))
    assert take(peers(key_file), datagram)


def test_every_flipped_bit_of_a_datagram_is_refused(key_file: Path) -> None:
    datagram = Signer("planner", read_key(key_file), lambda: 41).sign(b"icp_registerxxxx_a b|c.stl_#1;")
    known = peers(key_file)
    for place in range(len(datagram)):
        for bit in range(8):
            flipped = bytearray(datagram)
            flipped[place] ^= 1 << bit
            assert not take(known, bytes(flipped)), (place, bit)
    assert take(known, datagram)


@given(st.lists(st.integers(1, 30), min_size=1, max_size=30))
def test_only_what_has_grown_is_taken(key_file: Path, counters: list[int]) -> None:
    known, key, largest = peers(key_file, newest=3), read_key(key_file), 3
    for number in counters:
        datagram = Signer("planner", key, count(number).__next__).sign(b"stop_now_xxxxxxx;")
        assert take(known, datagram) == (number > largest)
        largest = max(largest, number)


@given(st.integers(0, 200))
def test_truncated_signature_is_refused(key_file: Path, length: int) -> None:
    datagram = Signer("planner", read_key(key_file), lambda: 41).sign(b"icp_registerxxxx_a.stl_#1;")
    kept = datagram[: length % len(datagram)]
    assert split(kept) is None


@pytest.mark.parametrize(
    "signature",
    [
        b"|planner|01|" + b"0" * 32,
        b"|planner|0|" + b"0" * 32,
        b"|planner|-1|" + b"0" * 32,
        b"|planner|10000000000000000000|" + b"0" * 32,
        b"|planner||" + b"0" * 32,
        b"||1|" + b"0" * 32,
        b"|" + b"p" * 33 + b"|1|" + b"0" * 32,
        b"|pl.nner|1|" + b"0" * 32,
        b"|planner|1|" + b"A" * 32,
        b"|planner|1|" + b"0" * 31,
        b"|planner|1|" + b"0" * 33,
        b"|planner|1|" + b"0" * 32 + b"\n",
        b"|planner|1|" + b"0" * 32 + b";",
    ],
)
def test_text_that_resembles_a_signature_is_none(signature: bytes) -> None:
    assert split(b"stop_now_xxxxxxx;" + signature) is None
    with pytest.raises(PayloadError):
        parse(b"stop_now_xxxxxxx;" + signature)


@pytest.mark.parametrize(("size", "fits"), [(MAX_BYTES, True), (MAX_BYTES + 1, False)])
def test_size_limit_is_of_the_command_without_its_signature(size: int, fits: bool) -> None:
    command = b"icp_registerxxxx_".ljust(size - 1, b"a") + b";"
    datagram = Signer("p" * 32, bytes(32), lambda: 10**19 - 1).sign(command)
    assert (split(datagram) is not None) is fits
    assert len(datagram) == size + 86


def test_a_command_that_is_sent_again_has_a_new_counter() -> None:
    sent = Signer("planner", bytes(32), lambda: 7)  # a clock that stands still
    counters = [parts.counter for parts in (split(sent.sign(b"stop_now_xxxxxxx;")) for _ in range(3)) if parts]
    assert counters == [7, 8, 9]


def test_counters_grow_across_restarts_of_a_client() -> None:
    first, second = (split(Signer("planner", bytes(32)).sign(b"stop_now_xxxxxxx;")) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.counter < second.counter


@pytest.mark.parametrize(
    ("name", "key"), [("a;b", bytes(32)), ("", bytes(32)), ("a" * 33, bytes(32)), ("a", bytes(31))]
)
def test_invalid_peer_cannot_sign(name: str, key: bytes) -> None:
    with pytest.raises(PayloadError):
        Signer(name, key)
    with pytest.raises(ValueError, match="has"):
        reference().Signer(name, key)


def reference() -> ModuleType:
    spec = importlib.util.spec_from_file_location("pcmrs_signer", CLIENTS / "python" / "pcmrs_signer.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("vector", VECTORS)
def test_all_python_signers_make_the_bytes_of_the_vectors(vector: dict[str, Any]) -> None:
    for maker in (Signer, reference().Signer):
        made = maker(vector["peer"], bytes.fromhex(vector["key"]), lambda: vector["counter"])
        assert made.sign(vector["command"].encode()) == vector["datagram"].encode()
    parts = split(vector["datagram"].encode())
    assert parts is not None
    assert parts.holds(bytes.fromhex(vector["key"]))


@pytest.mark.parametrize("vector", VECTORS)
def test_python_signers_accept_the_answers_of_the_vectors_only(vector: dict[str, Any]) -> None:
    key, answer = bytes.fromhex(vector["key"]), vector["signed_answer"].encode()
    assert sign_answer(vector["answer"], vector["peer"], vector["counter"], key).encode() == answer
    for maker in (Signer, reference().Signer):
        made = maker(vector["peer"], key, lambda: vector["counter"], answers_signed=True)
        with pytest.raises((PayloadError, ValueError), match="answer"):
            made.check(answer)  # nothing was asked yet
        made.sign(vector["command"].encode())
        assert made.check(answer) == vector["answer"].encode()


@pytest.mark.parametrize("place", range(len(VECTORS[1]["signed_answer"])))
def test_every_flipped_bit_of_an_answer_is_refused(place: int) -> None:
    vector = VECTORS[1]
    for maker in (Signer, reference().Signer):
        made = maker(vector["peer"], bytes.fromhex(vector["key"]), lambda: vector["counter"], answers_signed=True)
        made.sign(vector["command"].encode())
        for bit in range(8):
            flipped = bytearray(vector["signed_answer"].encode())
            flipped[place] ^= 1 << bit
            with pytest.raises((PayloadError, ValueError), match="answer"):
                made.check(bytes(flipped))


@pytest.mark.parametrize("maker", ["ours", "reference"])
def test_answer_to_another_run_is_refused(maker: str) -> None:
    made = (Signer if maker == "ours" else reference().Signer)("planner", bytes(32), count(5).__next__)
    made.sign(b"stop_now_xxxxxxx;")
    made.sign(b"stop_now_xxxxxxx;")
    for counter in (5, 6):
        assert made.check(sign_answer("ack", "planner", counter, bytes(32)).encode()) == b"ack;"
    command = Signer("planner", bytes(32), lambda: 5).sign(b"ack;")
    for wrong in (
        sign_answer("ack", "planner", 4, bytes(32)).encode(),
        sign_answer("ack", "planner", 7, bytes(32)).encode(),
        sign_answer("ack", "panel", 5, bytes(32)).encode(),
        sign_answer("ack", "planner", 5, b"k" * 32).encode(),
        command,
    ):
        with pytest.raises((PayloadError, ValueError), match="answer"):
            made.check(wrong)
    assert made.check(b"ack") == b"ack"  # of a daemon that does not sign, where that is allowed


def test_an_answer_is_no_command(key_file: Path) -> None:
    answer = sign_answer("stop_now_xxxxxxx;", "planner", 9, read_key(key_file))
    assert not take(peers(key_file), answer.encode())


def test_the_manual_shows_the_first_vector() -> None:
    assert bytes.fromhex(VECTORS[0]["key"]) == bytes(range(32))
    assert VECTORS[0]["datagram"] in (CLIENTS.parent / "docs" / "wire.md").read_text(encoding="utf-8").splitlines()


@given(_commands, st.integers(1, 10**18))
def test_the_reference_signs_as_the_planner_does(command: bytes, first: int) -> None:
    ours = Signer("planner", b"k" * 32, count(first).__next__)
    theirs = reference().Signer("planner", b"k" * 32, count(first).__next__)
    for _ in range(2):
        assert theirs.sign(command) == ours.sign(command)
    assert theirs.frame(command) == ours.sign(command) + b";"


def test_the_reference_reads_the_key_that_we_write(key_file: Path) -> None:
    assert reference().read_key(str(key_file)) == read_key(key_file)


def test_the_reference_runs_in_an_old_slicer() -> None:
    """Python 3.7, with nothing installed."""
    tree = ast.parse((CLIENTS / "python" / "pcmrs_signer.py").read_text(encoding="ascii"), feature_version=(3, 7))
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported == {"__future__", "hashlib", "hmac", "re", "time", "collections.abc", "pathlib"}


_MAIN = """
using System;
using System.Text;
using Pcmrs;

public static class Vectors
{
    public static void Main(string[] words)
    {
        byte[] key = Signer.ReadKey(words[1]);
        var signer = new Signer(words[0], key, () => long.Parse(words[2]), true);
        Console.WriteLine(Encoding.ASCII.GetString(signer.Sign(words[3])));
        foreach (string answer in new[] { words[4], words[4].Replace("|" + words[2] + "|", "|3|"), "ack;" })
        {
            try
            {
                Console.WriteLine(signer.Check(answer));
            }
            catch (FormatException)
            {
                Console.WriteLine("refused");
            }
        }
    }
}
"""


@pytest.mark.skipif(
    not (shutil.which("mcs") and shutil.which("mono")), reason="mcs and mono are not installed: C# is not compiled here"
)
def test_csharp_signer_matches_the_vectors_and_accepts_answers(tmp_path: Path) -> None:
    main, program, key = tmp_path / "Vectors.cs", tmp_path / "vectors.exe", tmp_path / "peer.key"
    main.write_text(_MAIN, encoding="ascii")
    source = CLIENTS / "unity" / "Runtime" / "Core" / "Signer.cs"
    subprocess.run(["mcs", "-langversion:7", "-warnaserror", f"-out:{program}", source, main], check=True)
    for vector in VECTORS:
        key.write_text(vector["key"] + "\n", encoding="ascii")
        words = [vector["peer"], key, str(vector["counter"]), vector["command"], vector["signed_answer"]]
        ran = subprocess.run(["mono", program, *words], check=True, capture_output=True)
        # On a line before, mono may tell that it does not know how this process is scheduled.
        told = [vector["datagram"], vector["answer"], "refused", "refused"]
        assert ran.stdout.decode("ascii").splitlines()[-4:] == told


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_key_readable_by_its_owner_only_is_read(tmp_path: Path, mode: int) -> None:
    file = tmp_path / "planner.key"
    new_key(file)
    file.chmod(mode)
    assert len(read_key(file)) == 32


@pytest.mark.parametrize("content", ["", "0" * 63, "0" * 65, "g" * 64, "0" * 64 + "\n\n", "é" * 64])
def test_a_file_without_a_key_is_refused_and_not_shown(tmp_path: Path, content: str) -> None:
    file = tmp_path / "planner.key"
    file.touch(mode=0o600)
    file.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="holds no key: 64 hex digits") as error:
        read_key(file)
    assert not content.strip() or content.strip() not in error.value.text


def test_a_missing_key_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="pcmrs peers new"):
        read_key(tmp_path / "none.key")


def test_keys_differ(tmp_path: Path) -> None:
    new_key(tmp_path / "a")
    new_key(tmp_path / "b")
    assert read_key(tmp_path / "a") != read_key(tmp_path / "b")
