"""Certificates of the lab's authority, judged by a TLS library that knows nothing of it."""

from __future__ import annotations

import json
import socket
import ssl
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography import x509
from cryptography.x509.oid import NameOID

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError
from pcmrs.messages.identity import EVERY_CELL, INFRASTRUCTURE, ROLES
from pcmrs.pki import Authority

DAY = 86400.0


def context_of(folder: Path, name: str, *, server: bool) -> ssl.SSLContext:
    """One side of a connection on which both have to show a certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER if server else ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(folder / "ca.pem")
    context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
    context.verify_mode = ssl.CERT_REQUIRED
    return context


def met(server: ssl.SSLContext, client: ssl.SSLContext, host: str = "127.0.0.1") -> tuple[str, bool]:
    """Common name that the server saw, or why not; and whether the client could read its answer."""
    seen: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            try:
                with server.wrap_socket(listening.accept()[0], server_side=True) as connection:
                    subject = connection.getpeercert() or {}
                    seen.append(subject["subject"][0][0][1])
                    connection.sendall(b"hello")
            except (ssl.SSLError, ConnectionError) as error:
                seen.append(getattr(error, "reason", None) or str(error))

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with (
                socket.create_connection(listening.getsockname()) as plain,
                client.wrap_socket(plain, server_hostname=host) as connection,
            ):
                answered = connection.recv(5) == b"hello"
        except (ssl.SSLError, ConnectionError):
            answered = False
        thread.join()
    return seen[0], answered


@pytest.mark.parametrize("role", [role for role in ROLES if role not in INFRASTRUCTURE])
def test_every_role_meets_the_router_under_its_name(
    authority: Authority, tmp_path: Path, now: float, role: str
) -> None:
    authority.issue("router", "gate", now, hosts=("127.0.0.1", "gate.lab"), cells=EVERY_CELL, into=tmp_path)
    authority.issue(role, "anna", now, cells=EVERY_CELL, into=tmp_path)  # type: ignore[arg-type]
    server = context_of(tmp_path / "gate", "gate", server=True)
    client = context_of(tmp_path / "anna", "anna", server=False)
    assert met(server, client) == ("anna", True)
    assert met(server, client, host="gate.lab") == ("anna", True)
    assert not met(server, client, host="other.lab")[1], "the router is not what the client has dialled"


def test_foreign_or_expired_certificate_is_not_accepted(authority: Authority, tmp_path: Path, now: float) -> None:
    authority.issue("router", "gate", now, hosts=("127.0.0.1",), cells=EVERY_CELL, into=tmp_path)
    server = context_of(tmp_path / "gate", "gate", server=True)
    foreign = Authority.init(tmp_path / "foreign", "lab", now)
    foreign.issue("operator", "eve", now, cells=EVERY_CELL, into=tmp_path)
    (tmp_path / "eve" / "ca.pem").write_bytes((tmp_path / "gate" / "ca.pem").read_bytes())
    seen, answered = met(server, context_of(tmp_path / "eve", "eve", server=False))
    assert (seen != "eve", answered) == (True, False)
    authority.issue("operator", "bob", now - 8 * DAY, days=7.0, cells=EVERY_CELL, into=tmp_path)
    assert met(server, context_of(tmp_path / "bob", "bob", server=False)) == ("CERTIFICATE_VERIFY_FAILED", False)


def test_client_certificate_does_not_serve_as_a_router(authority: Authority, tmp_path: Path, now: float) -> None:
    authority.issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path)
    authority.issue("viewer", "eve", now, cells=EVERY_CELL, into=tmp_path)
    server = context_of(tmp_path / "eve", "eve", server=True)
    client = context_of(tmp_path / "anna", "anna", server=False)
    client.check_hostname = False
    assert not met(server, client)[1]


def test_a_role_that_does_not_exist_is_given_to_nobody(authority: Authority, tmp_path: Path, now: float) -> None:
    with pytest.raises(ConfigurationError, match="'surgeon' is not a role; choose operator"):
        authority.issue("surgeon", "anna", now, cells=EVERY_CELL, into=tmp_path)  # type: ignore[arg-type]
    assert authority.identities() == []
    assert not (tmp_path / "anna").exists()


def test_a_name_is_never_given_to_two(authority: Authority, tmp_path: Path, now: float) -> None:
    first = authority.issue("operator", "anna", now, cells=EVERY_CELL, into=tmp_path).identity
    with pytest.raises(ConfigurationError, match="has the role operator already"):
        authority.issue("viewer", "anna", now, cells=EVERY_CELL, into=tmp_path)
    later = authority.issue("operator", "anna", now + DAY, cells=EVERY_CELL, into=tmp_path).identity
    assert later.serial != first.serial
    assert authority.identities() == [later]
    revoked = authority.revoke("anna", now + 2 * DAY)
    assert (later.valid(now + 2 * DAY), revoked.valid(now + 2 * DAY)) == (True, False)
    with pytest.raises(ConfigurationError, match="was revoked"):
        authority.issue("operator", "anna", now + 3 * DAY, cells=EVERY_CELL, into=tmp_path)
    for name in ("anna", "nobody"):
        with pytest.raises(ConfigurationError, match="cannot be revoked"):
            authority.revoke(name, now)


@pytest.mark.parametrize("days", [0.0, -1.0, 399.0, float("nan")])
def test_days_are_bounded(authority: Authority, tmp_path: Path, now: float, days: float) -> None:
    with pytest.raises(ConfigurationError, match="398"):
        authority.issue("operator", "anna", now, days=days, cells=EVERY_CELL, into=tmp_path)
    assert authority.identities() == []


@pytest.mark.parametrize("name", ["", "Anna", "a/b", "*", "a" * 64, "@adv", "anna otto"])
def test_a_name_is_a_part_of_a_key(authority: Authority, tmp_path: Path, now: float, name: str) -> None:
    with pytest.raises(ConfigurationError, match="cannot be a name"):
        authority.issue("operator", name, now, cells=EVERY_CELL, into=tmp_path)
    assert authority.identities() == []


def test_only_who_is_dialled_has_hosts(authority: Authority, tmp_path: Path, now: float) -> None:
    with pytest.raises(ConfigurationError, match="accepts no connections"):
        authority.issue("operator", "anna", now, hosts=("10.0.0.1",), cells=EVERY_CELL, into=tmp_path)
    with pytest.raises(ConfigurationError, match="give its hosts"):
        authority.issue("router", "gate", now, cells=EVERY_CELL, into=tmp_path)


@pytest.mark.parametrize("cells", [(), ("",), ("lab",), ("lab/c1/x",), ("lab/C1",), ("lab/**",), ("lab/c1", "a b/c")])
def test_certificate_for_an_invalid_cell_is_not_issued(
    authority: Authority, tmp_path: Path, now: float, cells: tuple[str, ...]
) -> None:
    with pytest.raises(ConfigurationError, match="is not a cell"):
        authority.issue("viewer", "eve", now, cells=cells, into=tmp_path)
    assert authority.identities() == []


def test_an_authority_is_made_once(authority: Authority, now: float) -> None:
    before = (authority.folder / "ca.key").read_bytes()
    with pytest.raises(ConfigurationError, match="already"):
        Authority.init(authority.folder, "lab", now)
    assert (authority.folder / "ca.key").read_bytes() == before


def test_the_commands_do_the_same(tmp_path: Path) -> None:
    def pcmrs(*words: str) -> tuple[int, str]:
        ended = CliRunner().invoke(main, ["pki", *words, "--folder", str(tmp_path / "pki")])
        return ended.exit_code, ended.output

    assert pcmrs("list")[0] == 4
    assert pcmrs("init")[0] == 0
    assert pcmrs("issue", "operator", "anna", "-o", str(tmp_path))[0] == 2  # of which cell has to be said
    words = ("--cell", "lab/c1", "--days", "7", "-o", str(tmp_path), "--json")
    status, output = pcmrs("issue", "operator", "anna", *words)
    issued = json.loads(output)
    assert (status, issued["folder"], issued["identity"]["role"]) == (0, str(tmp_path / "anna"), "operator")
    assert issued["identity"]["cells"] == ["lab/c1"]
    pem = x509.load_pem_x509_certificate((tmp_path / "anna" / "anna.pem").read_bytes())
    assert pem.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value == "anna"
    assert f"{pem.serial_number:x}" == issued["identity"]["serial"]
    assert pcmrs("issue", "surgeon", "bob")[0] == 2
    assert "anna" in pcmrs("list")[1]
    assert pcmrs("revoke", "anna")[0] == 0
    assert "revoked" in pcmrs("list")[1]
    assert [each["name"] for each in json.loads(pcmrs("list", "--json")[1])] == ["anna"]
    assert pcmrs("revoke", "anna")[0] == 4
    assert pcmrs("init")[0] == 4


def test_the_register_says_which_routers_carry_a_person(authority: Authority, tmp_path: Path, now: float) -> None:
    authority.issue("operator", "anna", now, via=("gate",), cells=EVERY_CELL, into=tmp_path)
    assert [each.via for each in authority.identities()] == [("gate",)]
    with pytest.raises(ConfigurationError, match="not of a device"):
        authority.issue("device", "arm", now, via=("gate",), cells=EVERY_CELL, into=tmp_path)
