"""Checks of a cell's surroundings: free ports, installed extras, devices, and valid certificates."""

from __future__ import annotations

import fcntl
import os
import socket
import stat
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, Final

import msgspec

from pcmrs.clock import SystemClock
from pcmrs.console.settings import HOST
from pcmrs.devices.lsl.library import lab_configuration
from pcmrs.doctor._check_result import CheckResult, bad, good, warning
from pcmrs.errors import ConfigurationError
from pcmrs.gateway.settings import UNIX_NS
from pcmrs.hosts import is_loopback
from pcmrs.installed import entry_points_of
from pcmrs.service.health.metrics import HOST as METRICS_HOST
from pcmrs.service.health.report import ENDS_SOON
from pcmrs.settings import DRIVER_SETTINGS, SIMULATED, Settings

EXTRAS: Final = {
    SIMULATED: (SIMULATED,),
    "ndi": ("hardware",),
    "plus": ("hardware",),
    "lsl": ("hardware",),
    "trigger": ("hardware",),
    "ros2": ("ros2",),
}
"""Driver to the extras that it needs; the simulated cell is a distribution by itself."""
DIALLED: Final = ("ndi", "plus")
"""Devices that accept a second client. A cabinet accepts one, and may end its application when it leaves."""
LSL_DRIVERS: Final = frozenset({"lsl", "trigger"})
"""Drivers that use Lab Streaming Layer."""
DIAL_TIME: Final = 2.0
POINT_TO_POINT: Final = (
    "the arm moves in segments of at most 5 mm, 1 mm near the target, and takes several times as long. A Stop, a lost "
    "heartbeat, a force or a zone ends it only at the end of a segment, at most 0.5 s later; it cannot press, follow "
    "the body or be guided"
)
"""Cost of motions that cannot be stopped on their way."""

Port = tuple[str, int, socket.SocketKind, str]
"""Host, number, kind, and the setting that names it."""


def is_running(settings: Settings) -> bool:
    """Return true if a daemon runs this cell: then its ports are taken, and its devices must not be dialled."""
    try:
        with (settings.cell.path() / "lock").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def ports(settings: Settings, *, running: bool) -> Iterator[CheckResult]:
    """Check that every port that the daemon binds is free.

    Args:
        settings: Settings of the cell.
        running: A daemon of this cell runs.
    """
    wanted = list(_ports(settings))
    if running:
        yield good("ports", "used by the daemon of this cell, which runs")
        return
    taken = False
    for host, port, kind, setting in wanted:
        if why := _why_not_bound(host, port, kind):
            taken = True
            name = "TCP" if kind == socket.SOCK_STREAM else "UDP"
            remedy = f"`ss -lntup 'sport = :{port}'` names the program that uses it: end it, or set {setting}."
            yield bad("ports", f"{name} port {port} of {host} cannot be bound: {why}", remedy)
    if not taken:
        yield good("ports", f"{', '.join(str(port) for _, port, *_ in wanted)} are free")


def extras(settings: Settings, wanted: Mapping[str, tuple[str, ...]] = EXTRAS) -> Iterator[CheckResult]:
    """Check that the packages are installed that drivers and page need.

    Args:
        settings: Settings of the cell.
        wanted: Driver to the extras that it needs.
    """
    needed = {"daemon"} | {extra for driver in settings.drivers() for extra in wanted.get(driver, ())}
    for extra in sorted(needed | ({"console"} if settings.console.enabled else set())):
        missing = [name for name in _packages(extra) if not _is_installed(name)]
        if not missing:
            yield good("extras", f"{extra}: installed")
        elif extra == "console":
            remedy = "Install it as docs/supply.md says, or set console.enabled=false."
            yield warning("extras", f"{extra}: {', '.join(missing)} is missing; no page is served", remedy)
        else:
            remedy = "Install it as docs/supply.md says, in the environment of pcmrs-serve."
            yield bad("extras", f"{extra}: {', '.join(missing)} is missing", remedy)


def devices(settings: Settings, *, running: bool) -> Iterator[CheckResult]:
    """Check that the addresses of the devices can be reached; nothing is sent to a device.

    Args:
        settings: Settings of the cell.
        running: A daemon of this cell runs.
    """
    if running:
        yield good("devices", "used by the daemon of this cell: `pcmrs health` shows their state")
        return
    for driver, served in settings.drivers().items():
        table: Mapping[str, Any] = getattr(settings, driver, {})
        name = f"{driver} ({', '.join(served)})"
        if place := _place(driver, table):
            yield _serial(name, place) if isinstance(place, Path) else _network(driver, name, *place)
        else:
            yield good("devices", f"{name}: it has no address to check")


def motion(settings: Settings) -> Iterator[CheckResult]:
    """Say what an arm without the servo option cannot do."""
    if settings.point_to_point:
        found = f'kst.motion = "ptp": {POINT_TO_POINT}'
        yield warning("motion", found, 'With the controller\'s servo option, set kst.motion = "servo".')
    else:
        yield good("motion", "the arm can be stopped at any time, and can press, follow and be guided")


def streams(settings: Settings) -> Iterator[CheckResult]:
    """Check that streams of Lab Streaming Layer stay on this machine."""
    if not (LSL_DRIVERS.intersection(settings.drivers()) or settings.gateway.markers.enabled):
        yield good("streams", "Lab Streaming Layer is not used")
    elif own := lab_configuration():
        remedy = f"Set ResolveScope = machine in {own}, or give these streams their own network."
        yield warning("streams", f"{own} configures Lab Streaming Layer; other machines may reach its streams", remedy)
    else:
        yield good("streams", "Lab Streaming Layer is offered to this machine only")


def peers(settings: Settings) -> Iterator[CheckResult]:
    """Check that old commands of signed peers are refused."""
    growing = sorted(name for name, peer in settings.gateway.peers.items() if peer.counter != UNIX_NS)
    if growing:
        remedy = 'Update their clients and set counter = "unix_ns" in their tables: docs/configuration.md.'
        found = f"{', '.join(growing)}: a delayed command is accepted, and answers are not signed"
        yield warning("peers", found, remedy)
    else:
        yield good("peers", f"{len(settings.gateway.peers)} peers sign their commands, all with the time")


def certificates(settings: Settings) -> Iterator[CheckResult]:
    """Check that the identity can be used, is registered, and does not end soon."""
    if not settings.access.is_open:
        yield good("certificates", "none: the cell can only be reached from this machine")
        return
    try:
        own = settings.bus("router").credentials
    except ConfigurationError as error:
        remedy = "`pcmrs pki issue` makes an identity, `pcmrs pki list` shows all registered ones: docs/access.md."
        yield bad("certificates", error.text, remedy)
        return
    days = 0.0 if own is None else (own.ends - SystemClock().wall()) / 86400.0
    if days * 86400.0 < ENDS_SOON:
        remedy = "Issue a new one with `pcmrs pki issue`, and restart the daemon."
        yield warning("certificates", f"the daemon's ends in {days:.1f} days", remedy)
    else:
        yield good("certificates", f"the daemon's is registered, and ends in {days:.0f} days")


def _ports(settings: Settings) -> Iterator[Port]:
    tcp, udp = socket.SOCK_STREAM, socket.SOCK_DGRAM
    for setting, endpoints in (("cell.endpoint", (settings.cell.endpoint,)), ("access.listen", settings.access.listen)):
        for endpoint in endpoints:
            host, _, number = endpoint.partition("/")[2].rpartition(":")
            yield host.strip("[]"), int(number), tcp, setting
    gateway = settings.gateway
    for name, link in gateway.links().items():
        if link.port:
            yield link.host or gateway.host, link.port, udp, f"gateway.{name}.port"
    if gateway.tcp_port:
        yield gateway.tcp_host or gateway.host, gateway.tcp_port, tcp, "gateway.tcp_port"
    if gateway.openigtlink.enabled and gateway.openigtlink.role == "server" and gateway.openigtlink.port:
        yield gateway.openigtlink.listen or gateway.host, gateway.openigtlink.port, tcp, "gateway.openigtlink.port"
    if settings.console.enabled:
        yield HOST, settings.console.port, tcp, "console.port"
    if settings.metrics.port:
        yield METRICS_HOST, settings.metrics.port, tcp, "metrics.port"


def _why_not_bound(host: str, port: int, kind: socket.SocketKind) -> str:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind)[0]
        with socket.socket(family, kind) as tried:
            if kind == socket.SOCK_STREAM:
                tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as servers do
            tried.bind(address)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _packages(extra: str) -> list[str]:
    if extra == SIMULATED:
        return [_name(line) for line in requires("pcmrs-sim") or []]
    ending = f'extra == "{extra}"'
    lines = [each.replace("'", '"') for each in requires("pcmrs") or []]
    return [_name(line) for line in lines if line.endswith(ending)]


def _name(requirement: str) -> str:
    return next(requirement[:at] for at, letter in enumerate(requirement) if not (letter.isalnum() or letter in "-_."))


def _is_installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def _place(driver: str, table: Mapping[str, Any]) -> Path | tuple[str, int] | None:
    """Return where a driver finds its device, by its table with the driver's defaults; None if it has no address."""
    point = next((each for each in entry_points_of(DRIVER_SETTINGS) if each.name == driver), None)
    if point is None:
        return None  # a driver of another distribution, without a table
    found = msgspec.convert(table, point.load())
    if driver == "ndi":
        host, _, port = found.device.rpartition(":")
        return Path(found.device) if found.device.startswith("/") else (host, int(port))
    if driver in ("kst", "plus"):
        return found.host, found.port
    return Path(found.port) if driver == "trigger" and found.port else None


def _serial(name: str, path: Path) -> CheckResult:
    try:
        there = stat.S_ISCHR(path.stat().st_mode)
    except OSError as error:
        remedy = "Check its cable; `ls /dev/tty*` lists the devices, deploy/cable/70-pcmrs.rules gives it a name."
        return bad("devices", f"{name}: {path}: {error.strerror}", remedy)
    if there and os.access(path, os.R_OK | os.W_OK):
        return good("devices", f"{name}: {path} is there and may be used")
    remedy = "Add the user who runs the daemon to the group dialout; for the unit, serial.conf of deploy/systemd."
    return bad("devices", f"{name}: {path} may not be used", remedy)


def _network(driver: str, name: str, host: str, port: int) -> CheckResult:
    where = f"{name}: {host}:{port}"
    if is_loopback(host):
        return good("devices", f"{where} is this machine: a virtual device")
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, port))  # sends nothing
            way = f"{where} is reached from {probe.getsockname()[0]}"
        if driver not in DIALLED:
            return good("devices", f"{way}; it is not dialled, since it accepts one client only")
        with socket.create_connection((host, port), DIAL_TIME):
            return good("devices", f"{way} and answers")
    except OSError as error:
        remedy = "Check its power, cable and address, and the drop-in network.conf of the unit: docs/devices.md."
        return bad("devices", f"{where}: {error.strerror or error}", remedy)
