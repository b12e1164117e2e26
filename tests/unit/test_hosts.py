"""Only addresses of this machine are loopback, however they are written; names are not looked up."""

from __future__ import annotations

import ipaddress
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.hosts import is_loopback, is_this_machine

LOOPBACK = ipaddress.ip_network("127.0.0.0/8")


@given(st.ip_addresses(v=4))
def test_addresses_are_loopback_in_one_network_only(address: ipaddress.IPv4Address) -> None:
    assert is_loopback(str(address)) == (address in LOOPBACK)


@given(st.integers(0, 2**24 - 1))
def test_every_address_of_that_network_is_loopback(host: int) -> None:
    assert is_loopback(str(LOOPBACK[host]))


@pytest.mark.parametrize(
    ("host", "loopback"), [("::1", True), ("0:0:0:0:0:0:0:1", True), ("::", False), ("fe80::1", False)]
)
def test_ipv6_has_one_loopback_address(host: str, loopback: bool) -> None:
    assert is_loopback(host) == loopback


@pytest.mark.parametrize("host", ["localhost", "", " 127.0.0.1", "127.1", "0x7f000001", "127.0.0.1:80", "0.0.0.0"])
def test_other_texts_are_not_looked_up(monkeypatch: pytest.MonkeyPatch, host: str) -> None:
    def look_up(*_: object, **__: object) -> None:
        pytest.fail("A name server would decide who may send commands.")

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    assert not is_loopback(host)


@pytest.mark.parametrize(
    ("host", "here"), [("localhost", True), ("127.0.0.2", True), ("::1", True), ("172.31.1.147", False), ("", False)]
)
def test_the_name_of_this_machine_counts_too(host: str, here: bool) -> None:
    assert is_this_machine(host) is here
