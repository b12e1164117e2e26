"""Host addresses."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Return True if `host` is a loopback IP address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_this_machine(host: str) -> bool:
    """Return True if `host` is ``localhost`` or a loopback IP address."""
    return host == "localhost" or is_loopback(host)
