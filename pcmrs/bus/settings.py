"""Settings of one process on the bus, and the Zenoh session that they describe."""

from __future__ import annotations

import json
import re
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
"""Endpoint of a daemon on this machine."""
SECURED: Final = "tls/"
"""Prefix of every endpoint on another machine."""
LOCAL_LEASE_MS: Final = 1000
"""Time after which an idle link on one machine is closed, ms."""
NETWORK_LEASE_MS: Final = 4000
"""Time after which an idle link over a network is closed, ms: with 20 % packet loss, TCP stalls for more than 1 s."""
_LARGEST: Final = MAX_BYTES + 64 * 1024
"""Largest message that a link accepts, with its envelope, bytes."""
STOPS: Final[dict[str, float]] = {"put": 1000.0, "query": 4000.0}
"""Greatest rate of messages on ``stop/*`` that a router accepts from one link, by kind, 1/s.

Zenoh drops the others before Python sees them, so that a flood cannot keep the daemon busy. This loses no Stop: nothing
can be released within the millisecond in which another press is dropped, because the hold of the first press takes
longer. A dropped query ends at once, without a reply. A query that follows the answer to another is not dropped.
"""


class Credentials(msgspec.Struct, frozen=True, kw_only=True):
    """Identity of a process, and the files that prove it. All files are PEM.

    Attributes:
        name: Common name of its certificate: the user in its keys.
        cells: Cells in which it has a role, as ``<site>/<cell>``.
        certificate: Path of its certificate.
        key: Path of the private key of the certificate.
        authority: Path of the certificate of the authority, which must have issued the peers' certificates.
        ends: Wall time at which the certificate expires, s.
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
        mode: ``router`` for the daemon, which listens; ``client`` for every other process.
        endpoint: Endpoint of the router: on this machine without certificates, or on another with them (``tls/...``).
            Empty for a router that does not listen on loopback.
        site: First part of the cell's name.
        cell: Second part of the cell's name.
        credentials: Identity; needed for all links to other machines.
        listen: Further endpoints of a router, all with certificates.
        routers: Endpoints of routers that a router dials, all with certificates.
        members: Register: everyone who may take part through a router with credentials.
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
        """User in the keys of this process."""
        on_site = self.endpoint and not self.endpoint.startswith(SECURED)
        return LOCAL if self.credentials is None or on_site else self.credentials.name

    def role_of(self, user: str) -> Role:
        """Return the role of a user by the register; without a register everyone is on site.

        Raises:
            AccessError: The register has no user of that name who may take part in this cell now.
        """
        if not self.members or user == ON_SITE.user:
            return ON_SITE.role
        return self.member(user, SystemClock().wall()).role

    def member(self, user: str, now: float) -> Identity:
        """Return the register's entry of a user who may take part in this cell.

        Args:
            user: Name of the user.
            now: Wall time, s.

        Raises:
            AccessError: The user may not take part; field ``why`` is ``unknown``, ``revoked``, ``expired`` or
                ``foreign``.
        """
        cell, found = f"{self.site}/{self.cell}", next((each for each in self.members if each.name == user), None)
        if found is None:
            raise AccessError(f"{user!r} is not in the register of {cell}.", user=user, why="unknown")
        if found.revoked is not None:
            raise AccessError(f"{user!r} is revoked: have a new identity issued.", user=user, why="revoked")
        if not found.valid(now):
            text = f"The certificate of {user!r} is not valid now: have a new one issued, or set the clock."
            raise AccessError(text, user=user, why="expired")
        if not found.in_cell(cell):
            text = f"{user!r} may take part in {' '.join(found.cells)}, not in {cell}."
            raise AccessError(text, user=user, why="foreign")
        return found

    def zenoh_config(self) -> dict[str, Any]:
        """Return Zenoh's configuration: no discovery by multicast or gossip, and no peer that is not in `members`.

        Raises:
            ConfigurationError: An endpoint on another machine is to be used without certificates.
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
            "transport/link/tx/lease": LOCAL_LEASE_MS if self.credentials is None else NETWORK_LEASE_MS,
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
            **{f"{side}_{what}": file for side in ("listen", "connect") for what, file in pair.items()},
        }
        if self.mode == "client":
            return {"transport/link/tls": tls}
        router = "" if self.endpoint else own.name
        access = access_control(self.members, router=router, on_site=bool(self.endpoint))
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
            text = f"{endpoint} is not an endpoint for other machines: it must begin with {SECURED}, for certificates."
            raise ConfigurationError(text, endpoint=endpoint)
        if self.credentials is None:
            text = f"{endpoint} requires a certificate: give the folder that `pcmrs pki issue` has made, --identity."
            raise ConfigurationError(text, endpoint=endpoint)
        return endpoint


def _limited(message: str, rate: float) -> dict[str, Any]:
    """Return Zenoh's rate limit of Stops by messages of one kind; it applies to each link by itself."""
    rules = [{"key_expr": "pcmrs/*/*/stop/*", "freq": rate}]
    return {"id": f"stop-{message}", "flows": ["ingress"], "messages": [message], "rules": rules}


_ENDPOINT = re.compile(r"[a-z]+/[^/\s]+:\d{1,5}")


def _on_site(endpoint: str) -> str:
    """Return an endpoint that only this machine can reach. Raises `ConfigurationError` for any other."""
    if not _ENDPOINT.fullmatch(endpoint):
        text = f"{endpoint!r} is no endpoint: write protocol, host and port, such as tcp/127.0.0.1:7447."
        raise ConfigurationError(text, endpoint=endpoint)
    host = endpoint.removeprefix("tcp/").rpartition(":")[0].strip("[]")
    if host != "localhost" and not is_loopback(host):
        text = f"{endpoint} can be reached from other machines without certificates: use 127.0.0.1, or {SECURED}..."
        raise ConfigurationError(text, endpoint=endpoint)
    return endpoint


def open_session(settings: BusSettings) -> zenoh.Session:
    """Open the session; blocks until it is open.

    Raises:
        BusError: An endpoint is in use (``router``), or no router answers or accepts the client (``client``).
        ConfigurationError: An endpoint on another machine is to be used without certificates.
    """
    config = zenoh.Config()
    for key, value in settings.zenoh_config().items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(_failure_text(settings), endpoint=settings.endpoint) from error


def _failure_text(settings: BusSettings) -> str:
    if settings.mode == "router":
        listening = " and ".join(filter(None, (settings.endpoint, *settings.listen)))
        return f"Cannot listen on {listening}: another daemon is there, or the address is not one of this machine."
    if settings.credentials is None:
        return f"No daemon answers at {settings.endpoint}: start pcmrs-serve, or give its endpoint."
    return (
        f"No router at {settings.endpoint} accepts {settings.user}: none runs there, its certificate is of another "
        "authority or host, or the certificate of this process has expired."
    )
