"""Keys stay in their files: no log, journal, record or output of a cell and a console has any of them."""

from __future__ import annotations

import json
import socket
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from pcmrs.gateway.signing import Signer, read_key
from pcmrs.testing.cell import LIGHT
from tests.system.network.remote_cell import Loopback, remote_cell


def secrets(folder: Path) -> Iterator[bytes]:
    """Every private number and shared key: as it is, as digits, and as the middle of its own file."""
    for file in folder.rglob("*.key"):
        text = file.read_bytes()
        if text.startswith(b"-----"):
            private = load_pem_private_key(text, None)
            if isinstance(private, Ed25519PrivateKey):
                key = private.private_bytes_raw()
            else:
                assert isinstance(private, EllipticCurvePrivateKey)
                key = private.private_numbers().private_value.to_bytes(32, "big")
            yield text.splitlines()[1][52:64]  # of the private number; a public one follows in the next line
        else:
            key = bytes.fromhex(text.decode())
        yield from (key, key.hex().encode(), b64encode(key)[:40])


def test_no_key_is_written_anywhere_else(tmp_path: Path) -> None:
    peers = tmp_path / "peers"
    peers.mkdir()
    key_file = peers / "planner.key"
    key_file.write_text("8f" * 16 + "0123456789abcdef" * 2)
    key_file.chmod(0o600)
    signed = (f"gateway.peers.planner.key_file={key_file}", "recording.enabled=true", "gateway.unsigned_peers=[]")
    printed: list[str] = []
    with remote_cell(Loopback(), tmp_path, *signed, *LIGHT) as cell:
        for words in (("call", "robot.connect"), ("state", "--json"), ("keys", "--json"), ("health", "--json")):
            done = cell.pcmrs(*words)
            printed += [done.stdout, done.stderr]
        wrong = Signer("planner", b"another key, 32 bytes long......")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for signer in (wrong, Signer("planner", read_key(key_file))):
                sender.sendto(signer.sign(b"get_jnt_angsxxxx_#1;"), tuple(cell.links["planner"]))
        cell.accept("lease.acquire")
        printed.append(json.dumps(cell.on_site()))
    everywhere = [file for file in tmp_path.rglob("*") if file.is_file() and file.suffix != ".key"]
    assert {"daemon.log", "ratms.sqlite"} <= {file.name for file in everywhere}
    assert "bad_tag" in (tmp_path / "daemon.log").read_text(), "what is refused is written, without the key"
    for secret in secrets(tmp_path):
        assert not [file for file in everywhere if secret in file.read_bytes()]
        assert not [text for text in printed if secret in text.encode()]
