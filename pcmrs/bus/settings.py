"""Where a process meets its cell, and the Zenoh session that follows from it."""

from __future__ import annotations

import json
from typing import Any, Final, Literal

import msgspec
import zenoh

from pcmrs.bus.access import access_control
from pcmrs.bus.codec import MAX_BYTES
from pcmrs.clock import SystemClock
from pcmrs.errors import AccessError, BusError, ConfigurationError
from pcmrs.hosts import is_loopback
from pcmrs.messages.identity import LOCAL, ON_SITE, Identity, Role

DEFAULT_ENDPOINT: Final = "tcp/127.0.0.1:7447"
SECURED: Final = "tls/"
"""Begins every endpoint that is not this machine's own."""
NEAR: Final = 1000
"""A link on one machine that carries nothing for so long is closed, ms."""
FAR: Final = 4000
"""The same where links go over a network: TCP stalls for more than a second when a fifth of the packets is lost."""
_LARGEST: Final = MAX_BYTES + 64 * 1024
"""Bytes of the largest message that is taken from a link, its envelope with it."""
STOPS: Final[dict[str, float]] = {"put": 1000.0, "query": 4000.0}
"""Messages on ``stop/*`` that a router takes from one link, by kind, 1/s. Zenoh drops the others before Python sees
them, so that a flood cannot keep the daemon busy. Nothing can be released within the millisecond in which another press
is dropped: the hold of the first one takes longer. A query that is dropped ends at once, without a reply; one that
follows the answer to another is not dropped."""


class Credentials(msgspec.Struct, frozen=True, kw_only=True):
    """Who a process is, and the files that prove it.

    Attributes:
        name: Its certificate's common name: the user in its keys.
        cells: In which it has a role, as ``<site>/<cell>``.
        certificate: Path in PEM, as of the others.
        key: Of the certificate.
        authority: Certificate of the authority that the others must have theirs from.
        ends: Wall time until which the certificate counts, s.
    """

    name: str
    cells: tuple[str, ...]
    certificate: str
    key: str
    authority: str
    ends: float


class BusSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The bus as one process uses it.

    Attributes:
        mode: The daemon is a ``router`` that listens; every other process is a ``client`` of one.
        endpoint: Where the router listens: of this machine without certificates, of others with them (``tls/...``).
            Empty for a router that has no such place on this machine.
        site: First name of the cell.
        cell: Second name of the cell.
        credentials: Needed for whatever leaves this machine.
        listen: Further endpoints of a router, all with certificates.
        routers: Routers that a router dials, all with certificates.
        members: Who may take part in what a router with credentials carries.
    """

    mode: Literal["router", "client"] = "client"
    endpoint: str = DEFAULT_ENDPOINT
    site: str = "lab"
    cell: str = "cell1"
    credentials: Credentials | None = None
    listen: tuple[str, ...] = ()
    routers: tuple[str, ...] = ()
    members: tuple[Identity, ...] = ()

    @property
    def user(self) -> str:
        """The user in the keys of this process."""
        on_site = self.endpoint and not self.endpoint.startswith(SECURED)
        return LOCAL if self.credentials is None or on_site else self.credentials.name

    def role_of(self, user: str) -> Role:
        """The register's. Without one everybody is on site.

        Raises:
            AccessError: The register has nobody of that name who may take part in this cell now.
        """
        if not self.members or user == ON_SITE.user:
            return ON_SITE.role
        return self.member(user, SystemClock().wall()).role

    def member(self, user: str, now: float) -> Identity:
        """Somebody in the register who may take part in this cell at the wall time `now`, s.

        Raises:
            AccessError: Nobody of that name may.
        """
        cell, found = f"{self.site}/{self.cell}", next((each for each in self.members if each.name == user), None)
        if found is None:
            raise AccessError(f"{user!r} is not in the register of {cell}.", user=user, why="unknown")
        if found.revoked is not None:
            raise AccessError(f"{user!r} is revoked: have a new identity issued.", user=user, why="revoked")
        if not found.valid(now):
            text = f"The certificate of {user!r} does not count now: have a new one issued, or set the clock."
            raise AccessError(text, user=user, why="expired")
        if not found.in_cell(cell):
            text = f"{user!r} may take part in {' '.join(found.cells)}, not in {cell}."
            raise AccessError(text, user=user, why="foreign")
        return found

    def values(self) -> dict[str, Any]:
        """Zenoh's configuration: nothing is found by multicast or gossip, nobody gets in whom `members` does not have.

        Raises:
            ConfigurationError: An endpoint that is not this machine's own is to be used without certificates.
        """
        return {
            "mode": self.mode,
            "listen/endpoints": self._listened(),
            "connect/endpoints": self._dialled(),
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 400, "period_increase_factor": 2},
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            # A router waits this long for scouted peers before it is open; there are none.
            "scouting/delay": 0,
            "adminspace/permissions": {"read": True, "write": False},
            "transport/link/protocols": ["tcp"] if self.credentials is None else ["tcp", "tls"],
            "transport/link/rx/max_message_size": _LARGEST,
            "transport/link/tx/lease": NEAR if self.credentials is None else FAR,
            "transport/link/tx/queue/congestion_control/block/wait_before_close": 500_000,
            "transport/shared_memory/enabled": False,
            "downsampling": [] if self.mode == "client" else [_limited(*each) for each in STOPS.items()],
        } | self._secrets()

    def _secrets(self) -> dict[str, Any]:
        own = self.credentials
        if own is None:
            return {}
        pair = {"certificate": own.certificate, "private_key": own.key}
        tls = {
            "root_ca_certificate": own.authority,
            "enable_mtls": True,
            "verify_name_on_connect": True,
            "close_link_on_expiration": True,
            **{f"{way}_{what}": file for way in ("listen", "connect") for what, file in pair.items()},
        }
        if self.mode == "client":
            return {"transport/link/tls": tls}
        between = "" if self.endpoint else own.name
        access = access_control(self.members, router=between, on_site=bool(self.endpoint))
        return {"transport/link/tls": tls, "access_control": access}

    def _listened(self) -> list[str]:
        if self.mode == "client":
            return []
        on_site = [_on_site(self.endpoint)] if self.endpoint else []
        return [*on_site, *map(self._secured, self.listen)]

    def _dialled(self) -> list[str]:
        if self.mode == "router":
            return [*map(self._secured, self.routers)]
        is_secured = self.endpoint.startswith(SECURED)
        return [self._secured(self.endpoint) if is_secured else _on_site(self.endpoint)]

    def _secured(self, endpoint: str) -> str:
        if not endpoint.startswith(SECURED):
            text = f"{endpoint} is no endpoint for other machines: it has to begin with {SECURED}, for certificates."
            raise ConfigurationError(text, endpoint=endpoint)
        if self.credentials is None:
            text = f"{endpoint} asks for a certificate: give the folder that `pcmrs pki issue` has made, --identity."
            raise ConfigurationError(text, endpoint=endpoint)
        return endpoint


def _limited(message: str, most: float) -> dict[str, Any]:
    """Zenoh's limit of Stops from one link by messages of a kind; each link has its own."""
    rules = [{"key_expr": "pcmrs/*/*/stop/*", "freq": most}]
    return {"id": f"stop-{message}", "flows": ["ingress"], "messages": [message], "rules": rules}


def _on_site(endpoint: str) -> str:
    """Returns an endpoint that is open to this machine only."""
    host = endpoint.removeprefix("tcp/").rpartition(":")[0].strip("[]")
    if host != "localhost" and not is_loopback(host):
        text = f"{endpoint} could be reached from other machines without certificates: use 127.0.0.1, or {SECURED}..."
        raise ConfigurationError(text, endpoint=endpoint)
    return endpoint


def open_session(settings: BusSettings) -> zenoh.Session:
    """Opens the session; blocks for as long as that takes.

    Raises:
        BusError: An endpoint is taken (``router``), or nobody answers or lets us in (``client``).
        ConfigurationError: An endpoint that is not this machine's own is to be used without certificates.
    """
    config = zenoh.Config()
    for key, value in settings.values().items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(_why(settings), endpoint=settings.endpoint) from error


def _why(settings: BusSettings) -> str:
    if settings.mode == "router":
        listening = " and ".join(filter(None, (settings.endpoint, *settings.listen)))
        return f"Cannot listen on {listening}: another daemon is there, or the address is not ours."
    if settings.credentials is None:
        return f"No daemon answers at {settings.endpoint}: start pcmrs-serve, or give its endpoint."
    return (
        f"Nobody at {settings.endpoint} lets {settings.user} in: nothing runs there, its certificate is of another "
        "authority or host, or this one has expired."
    )
