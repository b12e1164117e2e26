"""The whole configuration of one cell: what `pcmrs-serve` and the device nodes read."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import msgspec

from pcmrs.bus import BusSettings, Credentials
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.seal import read_key
from pcmrs.bus.settings import SECURED
from pcmrs.clock import SystemClock
from pcmrs.config import as_config, merge_tables, read_file, set_values
from pcmrs.console.settings import ConsoleSettings
from pcmrs.devices.dwell import DwellSettings
from pcmrs.devices.opening import DRIVERS
from pcmrs.errors import ConfigurationError, PayloadError
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages.identity import Identity
from pcmrs.pki import check_registered, read_credentials, read_register
from pcmrs.recording.settings import RecordingSettings
from pcmrs.workflows import find_workflow, read_workflow
from pcmrs.workflows.settings import ProcedureSettings

DRIVER_SETTINGS = "pcmrs.driver_settings"
SIMULATIONS = "pcmrs.simulations"
SIMULATED = "sim"
"""Driver of the simulated cell, which another distribution brings."""
"""Drivers that open their devices in the process that asks, as simulated time needs it."""
DEVICES = ("robot", "tracker", "pointer", "scene", "stimulator", "emg")
TABLES = ("sim", "kst", "ndi", "plus", "lsl", "trigger", "ros2")
"""Drivers that have a table of their own."""
DWELL = "dwell"
"""The driver of a pointer that is no device: the daemon watches it by the tracker."""

WORKFLOW_TABLES = frozenset(
    {"procedure.body", "procedure.limits", "procedure.registration", "procedure.tool", "procedure.zones", "sim"}
)
"""Tables whose defaults a workflow may change; patient, calibration and the cell are none of its business."""


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the tables of the configuration; unknown keys are refused."""


class CellSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Which cell this is.

    Attributes:
        site: First part of its name on the bus.
        name: Second part.
        endpoint: Where the daemon's bus router listens.
        rate: Seconds of the cell per second of the machine; more than 1 only with simulated devices.
        folder: Where journal and records are kept; empty for ``pcmrs/<site>-<name>`` in the user's state folder.
    """

    site: str = "lab"
    name: str = "cell1"
    endpoint: str = "tcp/127.0.0.1:7447"
    rate: Annotated[float, msgspec.Meta(ge=1.0, le=50.0)] = 1.0
    folder: str = ""

    def path(self) -> Path:
        """The folder as a path."""
        if self.folder:
            return Path(self.folder).expanduser()
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        return Path(state) / "pcmrs" / f"{self.site}-{self.name}"

    def journal(self, workflow: str) -> Path:
        """The journal of the workflow whose blueprint has this id."""
        return self.path() / f"{workflow}.sqlite"


class DeviceSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Which driver serves a device; ``none`` where another machine runs its node, or there is no such device."""

    driver: str = "sim"


class PointerSettings(DeviceSettings, frozen=True, forbid_unknown_fields=True):
    """The pointer; its driver ``dwell`` needs no device: a touch is a tip that the tracker sees held still.

    Attributes:
        dwell: How still and how long.
    """

    dwell: DwellSettings = DwellSettings()


class RobotSettings(DeviceSettings, frozen=True, forbid_unknown_fields=True):
    """The arm: its driver and its model, a name of `find_arm` or the path of a URDF file.

    Attributes:
        force_limit: The driver stops the arm when the force on the tool exceeds this, N.
        relief_mm: Before that it draws the tool back along its axis by so much at most, to relieve the force.
        deadman: Its node holds the moving arm by itself when it has not heard the daemon for so long, s of the machine;
            a servo session ends so long after its last set point.
    """

    model: str = "iiwa14"
    force_limit: Annotated[float, msgspec.Meta(gt=0.0)] = 25.0
    relief_mm: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.1


class AccessSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Who may reach the cell from other machines: nobody, unless it has an identity.

    Attributes:
        identity: Folder that ``pcmrs pki issue`` has made for this process; empty: this machine only.
        register: Copy of the authority's register: everybody who may take part, with role and cells.
        listen: Endpoints at which others dial this cell, such as ``tls/0.0.0.0:7448``.
        routers: Routers that this cell dials, such as ``tls/router.example.org:7449``.
        device_key: File with the key that daemon and device nodes of other machines share, as ``pcmrs pki device-key``
            makes it; empty: the daemon makes a new one at each start, for the nodes that it starts itself.
        lease_s: Whoever holds the cell from elsewhere and is not heard for so long does not hold it any more, s.
    """

    identity: str = ""
    register: str = ""
    listen: tuple[str, ...] = ()
    routers: tuple[str, ...] = ()
    device_key: str = ""
    lease_s: Annotated[float, msgspec.Meta(ge=3.0, le=600.0)] = 10.0

    @property
    def is_open(self) -> bool:
        """True if others than this machine may reach the cell: then somebody has to hold it."""
        return bool(self.identity)

    def credentials(self) -> Credentials | None:
        """The identity, looked at and found usable; None without one. Raises `ConfigurationError`."""
        return read_credentials(Path(self.identity), SystemClock().wall()) if self.identity else None

    def read_device_key(self) -> bytes | None:
        """The key in the file `device_key`; None where none is configured. Raises `ConfigurationError`."""
        return read_key(Path(self.device_key)) if self.device_key else None

    def members(self) -> tuple[Identity, ...]:
        """Everybody in the register. Raises `ConfigurationError`."""
        return tuple(read_register(Path(self.register))) if self.register else ()


class JournalSettings(Table, frozen=True, forbid_unknown_fields=True):
    """The journal.

    Attributes:
        durable: Without it decisions survive a kill but not a power cut: for benchmarks.
        largest_mb: Beyond this size the journal goes on in a new file, MB.
        warn_free_mb: With less free space on its disk the daemon warns, MB.
        least_free_mb: With less it accepts no state change any more; Stop, events and what runs still have room, MB.
    """

    durable: bool = True
    largest_mb: Annotated[float, msgspec.Meta(gt=0.0)] = 256.0
    warn_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 1000.0
    least_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 100.0


class MetricsSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Metrics for Prometheus over HTTP, on loopback only.

    Attributes:
        port: Where they are served, 0 takes a free one; none are served without it.
    """

    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] | None = None


class Settings(Table, frozen=True, forbid_unknown_fields=True):
    """The root of the configuration.

    Attributes:
        workflow: Name of a workflow, or path of its blueprint: ``something.toml``.
        sim: Read by the simulated devices; so are the tables of the other drivers by theirs.
    """

    workflow: str = "ratms"
    cell: CellSettings = CellSettings()
    robot: RobotSettings = RobotSettings()
    tracker: DeviceSettings = DeviceSettings()
    pointer: PointerSettings = PointerSettings()
    scene: DeviceSettings = DeviceSettings()
    stimulator: DeviceSettings = DeviceSettings()
    emg: DeviceSettings = DeviceSettings()
    procedure: ProcedureSettings = ProcedureSettings()
    gateway: GatewayConfig = GatewayConfig()
    access: AccessSettings = AccessSettings()
    journal: JournalSettings = JournalSettings()
    recording: RecordingSettings = RecordingSettings()
    metrics: MetricsSettings = MetricsSettings()
    console: ConsoleSettings = ConsoleSettings()
    sim: dict[str, Any] = {}
    kst: dict[str, Any] = {}
    ndi: dict[str, Any] = {}
    plus: dict[str, Any] = {}
    lsl: dict[str, Any] = {}
    trigger: dict[str, Any] = {}
    ros2: dict[str, Any] = {}

    def drivers(self) -> dict[str, list[str]]:
        """Driver name to the devices its node serves, without those that another machine serves."""
        found: dict[str, list[str]] = {}
        for device in DEVICES:
            driver = getattr(self, device).driver
            if driver not in ("none", DWELL):
                found.setdefault(driver, []).append(device)
        return found

    def bus(self, mode: str) -> BusSettings:
        """How a process of this cell joins the bus: the daemon as ``router``, others as ``client``.

        Raises:
            ConfigurationError: Its identity, or the register, cannot be used.
        """
        cell, access = self.cell, self.access
        on_site = mode == "client" and not cell.endpoint.startswith(SECURED)
        own = None if on_site else access.credentials()
        as_client = BusSettings(endpoint=cell.endpoint, site=cell.site, cell=cell.name, credentials=own)
        if mode == "client":
            return as_client
        members = access.members()
        if own is not None:
            check_registered(own, members, "daemon", f"{cell.site}/{cell.name}")
        return msgspec.structs.replace(
            as_client, mode="router", listen=access.listen, routers=access.routers, members=members
        )


class Inherited(msgspec.Struct, frozen=True, kw_only=True):
    """What a child process of the daemon gets on its standard input, as one line of JSON.

    Attributes:
        settings: Of the daemon.
        device_key: With which daemon and nodes seal what they send; empty for a child that only reads.
    """

    settings: Settings
    device_key: bytes = b""


def read_settings(file: Path | None = None, overrides: Sequence[str] = ()) -> Settings:
    """Read and check the whole configuration: what the workflow changes in the defaults, the file, single values.

    Args:
        file: TOML file; the path of a workflow, an arm or a calibration in it is relative to its folder.
        overrides: ``key=value`` each; such a path there is relative to the working directory.

    Raises:
        ConfigurationError: A key is unknown or a value cannot be used; the text says which and what to do.
    """
    values = _values(file, overrides)
    defaults = _defaults_of(values)
    settings = as_config(Settings, merge_tables(defaults, values))
    _check_limits(settings, defaults)
    _check_cell(settings)
    simulated = SIMULATED in settings.drivers()
    if not simulated and SIMULATED not in values:
        # What the workflow says of a simulation does not matter where there is none; nor need it be installed.
        settings = msgspec.structs.replace(settings, sim={})
    if simulated:
        _check_driver_tables({SIMULATED: defaults.get(SIMULATED, {})}, f" in {_origin(settings.workflow)}")
    used = settings.drivers().keys() | values.keys()
    _check_driver_tables({driver: getattr(settings, driver) for driver in TABLES if driver in used})
    return settings


def _values(file: Path | None, overrides: Sequence[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if file is not None:
        values = read_file(file)
        _resolve_paths(values, file.absolute().parent)
    set_values(values, overrides)
    _resolve_paths(values, Path.cwd())
    return values


def _resolve_paths(values: dict[str, Any], folder: Path) -> None:
    """Make the paths of a workflow, an arm, of calibrations and of secrets absolute; an absolute one stays."""
    procedure = values.get("procedure")
    calibration = procedure.get("calibration") if isinstance(procedure, dict) else None
    access = values.get("access")
    for table, key, ending in (
        (values, "workflow", ".toml"),
        (values.get("robot"), "model", ".urdf"),
        (calibration, "tool_file", ".toml"),
        (calibration, "pointer_file", ".toml"),
        (access, "identity", ""),
        (access, "register", ""),
    ):
        if isinstance(table, dict) and isinstance(name := table.get(key), str) and name and name.endswith(ending):
            table[key] = str(folder / Path(name).expanduser())


def _defaults_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """What the workflow changes in the defaults, checked by itself so that errors name its blueprint."""
    name = values.get("workflow", Settings().workflow)
    if not isinstance(name, str):
        return {}  # refused with all the other values
    defaults = read_workflow(name).defaults
    origin = _origin(name)
    as_config(Settings, defaults, origin)
    changed = {*defaults} - {"procedure"} | {f"procedure.{table}" for table in defaults.get("procedure", {})}
    for table in sorted(changed - WORKFLOW_TABLES):
        text = f"{origin} sets {table}; a workflow may change {', '.join(sorted(OF_WORKFLOW))} only."
        raise ConfigurationError(text, table=table)
    return defaults


def _origin(workflow: str) -> str:
    return f"The table [defaults] of {find_workflow(workflow).blueprint}"


def _check_limits(settings: Settings, defaults: Mapping[str, Any]) -> None:
    known = defaults.get("procedure", {}).get("limits", {})
    for name in sorted(settings.procedure.limits.keys() - known):
        text = f"procedure.limits.{name} is no limit of {settings.workflow}; it has {', '.join(known) or 'none'}."
        raise ConfigurationError(text, limit=name)


def _check_cell(settings: Settings) -> None:
    """Name, arm and drivers: what the types alone do not refuse."""
    try:
        cell_prefix(settings.cell.site, settings.cell.name)
    except PayloadError as error:
        raise ConfigurationError(f"cell.site and cell.name: {error.text}", **error.fields) from None
    _check_home(settings.procedure.home, find_arm(settings.robot.model))
    known = {point.name for point in entry_points(group=DRIVERS)}
    _check_dwell(settings)
    _check_access(settings.access)
    for driver in settings.drivers():
        if driver not in known:
            text = f"There is no driver {driver!r}; installed are {', '.join(sorted(known)) or 'none'}."
            if driver == SIMULATED:
                text = "The driver 'sim' is not installed: install the distribution pcmrs-sim (docs/supply.md)."
            raise ConfigurationError(text, driver=driver)
    real = sorted(set(settings.drivers()) - {SIMULATED})
    if settings.cell.rate != 1.0 and real:
        text = f"cell.rate is {settings.cell.rate:g}, but {', '.join(real)} runs in real time: only 1 is possible."
        raise ConfigurationError(text, rate=settings.cell.rate)


def _check_access(access: AccessSettings) -> None:
    if (access.listen or access.routers) and not (access.identity and access.register):
        text = (
            "access.listen and access.routers open the cell to other machines: give access.identity and "
            "access.register, which `pcmrs pki` makes."
        )
        raise ConfigurationError(text, listen=list(access.listen), routers=list(access.routers))


def _check_dwell(settings: Settings) -> None:
    wrong = [device for device in DEVICES if device != "pointer" and getattr(settings, device).driver == DWELL]
    if wrong:
        text = f"The driver {DWELL!r} is one of the pointer, not of {', '.join(wrong)}; choose another one there."
        raise ConfigurationError(text, devices=wrong)


def _check_home(home: tuple[float, ...], arm: ArmFacts) -> None:
    if len(home) not in (0, len(arm.joints)):  # none: the arm's own
        text = f"procedure.home holds {len(home)} numbers; {arm.name} has {len(arm.joints)} joints."
        raise ConfigurationError(text, home=list(home))


def _check_driver_tables(tables: Mapping[str, Mapping[str, Any]], where: str = "") -> None:
    """Each driver's own table, against the type that the driver declares for it."""
    for point in entry_points(group=DRIVER_SETTINGS):
        if point.name in tables:
            try:
                msgspec.convert(tables[point.name], point.load())
            except ImportError as error:
                raise ConfigurationError(f"The driver {point.name!r} is not installed: {error}") from None
            except msgspec.ValidationError as error:
                raise ConfigurationError(f"The table [{point.name}]{where} is wrong: {error}.") from None
