"""Configuration of the links."""

from __future__ import annotations

import ipaddress
import math
from pathlib import Path
from typing import Annotated, Final, Literal

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.gateway.commands import DEFAULT, allowed
from pcmrs.gateway.signing import PEER_NAME
from pcmrs.hosts import is_loopback
from pcmrs.messages.identity import LOCAL

MAX_PEERS = 64
UNIX_NS: Final = "unix_ns"
"""Kind of counters that are nanoseconds since 1970."""

Port = Annotated[int, msgspec.Meta(ge=0, le=65535)]


class LinkConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Address and UDP ports of one link; a port is None where the link has no such direction.

    Attributes:
        host: Address that this link is bound to; empty for `gateway.host`. On one other than loopback, its commands
            have to be signed, whatever the other links require.
        port: Commands arrive here; 0 takes any free port.
        reply_port: Acknowledgements and second datagrams go to this port of the sender's host.
        stream_port: Streams go to this port of the client's host.
    """

    host: str = ""
    port: Port | None = None
    reply_port: Port | None = None
    stream_port: Port | None = None


class OpenIgtLinkConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The OpenIGTLink link with 3D Slicer.

    Attributes:
        enabled: Off unless asked for.
        role: ``server``: Slicer connects to us. ``client``: we connect to Slicer's server.
        listen: Address that a server is bound to; empty for `gateway.host`. On one other than loopback, it takes no
            plans.
        host: Slicer's host; a server does not need it.
        port: Ours as a server, 0 takes any free one; Slicer's as a client.
        rate_hz: Rate of the poses.
        poses: As one TRANSFORM each, or together as TDATA.
        target: Name of the TRANSFORM, tool to image, that is taken as tool plan.
        landmarks: Name of the POINT list that is taken as landmark plan.

    Raises:
        ConfigurationError: The rate is not positive or above 1000, a client has no port, or a name is none or one that
            we send.
    """

    enabled: bool = False
    role: Literal["server", "client"] = "server"
    listen: str = ""
    host: str = "127.0.0.1"
    port: Port = 18944
    rate_hz: float = 30.0
    poses: Literal["TRANSFORM", "TDATA"] = "TRANSFORM"
    target: str = "ToolTargetToImage"
    landmarks: str = "Landmarks"

    def __post_init__(self) -> None:
        if not 0.0 < self.rate_hz <= 1000.0:
            raise ConfigurationError(
                f"openigtlink.rate_hz is {self.rate_hz:g}; it must be above 0, and 1000 at most.", rate_hz=self.rate_hz
            )
        if self.role == "client" and not self.port:
            raise ConfigurationError("openigtlink.port is 0; a client needs the port of Slicer's server.", port=0)
        for field in ("target", "landmarks"):
            name = getattr(self, field)
            if not (name.isascii() and 1 <= len(name) <= 20) or name == "TargetToImage":
                raise ConfigurationError(
                    f"openigtlink.{field} is {name!r}; it must have 1 to 20 ASCII letters, and not be TargetToImage, "
                    "which we send.",
                    **{field: name},
                )


class MarkersConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The stream of markers on Lab Streaming Layer.

    Attributes:
        enabled: Off unless asked for.
        stream: Its name.
    """

    enabled: bool = False
    stream: str = "pcmrs_markers"


class PeerConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A peer that signs its commands, and may therefore send from anywhere.

    Attributes:
        key_file: Its key: an absolute path, or one that begins with ``~``; see ``pcmrs peers new``.
        role: What the daemon lets it do; motion is for operators and teleoperators.
        allow: Commands and groups of commands that it may give. Stop may always be given.
        rate: Commands per second that it may give in the long run; Stop is never limited.
        burst: Commands that it may give at once: a plan is one for each landmark and two more.
        counter: ``unix_ns``: its counters are nanoseconds since 1970, so that a command that was held back on its way
            is known and refused; answers to it are signed. ``growing``: they only grow, as those of older clients.

    Raises:
        ConfigurationError: The path is relative, an entry of `allow` is neither, or no command could ever be given.
    """

    key_file: str
    role: Literal["operator", "planner", "teleoperator"] = "planner"
    allow: tuple[str, ...] = DEFAULT
    rate: float = 50.0
    burst: int = 200
    counter: Literal["growing", "unix_ns"] = "growing"

    def __post_init__(self) -> None:
        if not Path(self.key_file).expanduser().is_absolute():
            raise ConfigurationError(
                f"key_file is {self.key_file!r}; it must be an absolute path, wherever the daemon is started.",
                key_file=self.key_file,
            )
        allowed(self.allow)
        if not (0.0 < self.rate < math.inf and self.burst >= 1):
            raise ConfigurationError(
                f"rate is {self.rate:g} and burst {self.burst}; the rate must be greater than 0, the burst 1 or more.",
                rate=self.rate,
                burst=self.burst,
            )


class GatewayConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All links of the gateway.

    Attributes:
        host: Address of each link whose own is empty. On one other than loopback, commands have to be signed.
        client_host: IPv4 address that the streams for planner and visualization go to.
        mixed_reality_host: IPv4 address that the mixed reality stream goes to.
        tcp_host: Address that the TCP link is bound to; empty for `host`.
        tcp_port: Port of the TCP link, 8058 by convention; 0 takes any free port. None, the default: no TCP link.
        stream_rate_hz: Rate of the pose streams.
        tip_rate_hz: Rate of the stream of the pointer tip; 5 as that of the public daemon, whose modules draw each one.
        surgeon: Name of the surgeon, who stands beside the panel: `session_reinitxx` records it where a workflow needs
            the surgeon's statement that nothing is in the bone. A signed peer needs the group ``treat`` for that.
            Empty: string commands cannot state that.
        openigtlink: The link with 3D Slicer.
        markers: Markers of what the procedure does, on Lab Streaming Layer.
        lab_files: Folder in which the daemon keeps the lab's YAML files of the procedure up to date, for modules and
            scripts that read them. Empty, the default: no files.
        unsigned_peers: Loopback addresses whose unsigned commands are accepted.
        peers: Peers that sign their commands, by name.

    Raises:
        ConfigurationError: `unsigned_peers` holds an address that is not loopback, a stream's host is no IPv4
            address, a rate is not positive, or there are too many peers or one whose name cannot be signed.
    """

    host: str = "127.0.0.1"
    client_host: str = "127.0.0.1"
    mixed_reality_host: str = "127.0.0.1"
    planner: LinkConfig = LinkConfig(port=8057, reply_port=8059, stream_port=8083)
    robot: LinkConfig = LinkConfig(port=8072, reply_port=8063)
    visualization: LinkConfig = LinkConfig(port=8077, reply_port=8069, stream_port=8079)
    mixed_reality: LinkConfig = LinkConfig(reply_port=28051, stream_port=8051)
    mep: LinkConfig = LinkConfig(port=8085)
    tcp_host: str = ""
    tcp_port: Port | None = None
    stream_rate_hz: float = 100.0
    tip_rate_hz: float = 5.0
    surgeon: Annotated[str, msgspec.Meta(max_length=100)] = ""
    openigtlink: OpenIgtLinkConfig = OpenIgtLinkConfig()
    markers: MarkersConfig = MarkersConfig()
    lab_files: str = ""
    unsigned_peers: tuple[str, ...] = ("127.0.0.1", "::1")
    peers: dict[str, PeerConfig] = {}

    def __post_init__(self) -> None:
        _check_peers(self.peers)
        for peer in self.unsigned_peers:
            if not is_loopback(peer):
                raise ConfigurationError(
                    f"unsigned_peers holds {peer!r}; unsigned commands are accepted from loopback addresses only, "
                    "such as 127.0.0.1. Remove it.",
                    peer=peer,
                )
        _check_ipv4("client_host", self.client_host)
        _check_ipv4("mixed_reality_host", self.mixed_reality_host)
        if not self.surgeon.isprintable():
            text = f"surgeon is {self.surgeon!r}; write the name in printable letters."
            raise ConfigurationError(text, surgeon=self.surgeon)
        if not 0.0 < self.tip_rate_hz <= 1000.0:
            raise ConfigurationError(
                f"tip_rate_hz is {self.tip_rate_hz:g}; it must be above 0, and 1000 at most.",
                tip_rate_hz=self.tip_rate_hz,
            )
        if not self.stream_rate_hz > 0.0:
            raise ConfigurationError(
                f"stream_rate_hz is {self.stream_rate_hz:g}; it must be greater than 0, 60 or more for visualization.",
                stream_rate_hz=self.stream_rate_hz,
            )

    def links(self) -> dict[str, LinkConfig]:
        """Return the UDP links by name."""
        return {
            "planner": self.planner,
            "robot": self.robot,
            "visualization": self.visualization,
            "mixed_reality": self.mixed_reality,
            "mep": self.mep,
        }


def _check_peers(peers: dict[str, PeerConfig]) -> None:
    if len(peers) > MAX_PEERS:
        text = f"There are {len(peers)} peers, the limit is {MAX_PEERS}; remove those that are not used."
        raise ConfigurationError(text, count=len(peers), limit=MAX_PEERS)
    for name in peers:
        if not PEER_NAME.fullmatch(name):
            text = f"peers holds {name!r}; a peer's name has 1 to 32 letters, digits, '-' and '_'."
            raise ConfigurationError(text, peer=name)
        if name.lower() == LOCAL:
            text = f"peers holds {name!r}, the name of the user at the cell's own machine: choose another one."
            raise ConfigurationError(text, peer=name)


def _check_ipv4(name: str, host: str) -> None:
    """Refuse a host name, which would have to be looked up at every datagram."""
    try:
        ipaddress.IPv4Address(host)
    except ValueError:
        raise ConfigurationError(
            f"{name} is {host!r}; it must be an IPv4 address such as 192.0.2.7. Write the address that a name has.",
            **{name: host},
        ) from None
