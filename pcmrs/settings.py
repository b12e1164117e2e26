"""The whole configuration of one cell, which `pcmrs-serve` and the device nodes read."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from pcmrs.bus import BusSettings, Credentials
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.seal import read_key
from pcmrs.bus.settings import SECURED
from pcmrs.clock import SystemClock
from pcmrs.config import Where, as_config, merge_tables, read_file, set_values
from pcmrs.console.settings import ConsoleSettings
from pcmrs.devices.dwell import DwellSettings
from pcmrs.devices.opening import DRIVERS
from pcmrs.errors import BlueprintError, ConfigurationError, PayloadError
from pcmrs.fsm.files.places import Places
from pcmrs.fsm.files.toml import read_toml
from pcmrs.gateway.settings import GatewayConfig
from pcmrs.hosts import is_this_machine
from pcmrs.installed import entry_points_of
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages.identity import Identity
from pcmrs.pki import check_registered, read_credentials, read_register
from pcmrs.recording.settings import RecordingSettings
from pcmrs.scene.camera_settings import SceneCameraSettings
from pcmrs.scene.settings import SceneEventSettings
from pcmrs.workflows import find_workflow, read_workflow
from pcmrs.workflows.settings import ProcedureSettings

__all__ = ["Settings", "read_settings"]

SCHEMA: Final = 1
"""Version of the format of the configuration."""
JOURNAL_SUFFIX = ".sqlite"
DRIVER_SETTINGS = "pcmrs.driver_settings"
"""Group of the entry points that name the settings of drivers."""
SIMULATED = "sim"
"""Driver of the simulated cell, which the distribution pcmrs-sim provides."""
DEVICES = ("robot", "tracker", "pointer", "scene", "stimulator", "emg")
"""Names of all devices."""
TABLES = ("sim", "kst", "ndi", "plus", "lsl", "trigger", "ros2")
"""Drivers that have their own table."""
DWELL = "dwell"
"""Driver of a pointer without electronics: the daemon watches it with the tracker."""

WORKFLOW_TABLES = frozenset(
    {"procedure.body", "procedure.limits", "procedure.registration", "procedure.tool", "procedure.zones", "sim"}
)
"""Tables whose defaults a workflow may change; it may not change patient, calibration and cell."""


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the tables of the configuration; unknown keys are refused."""


class CellSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Name, endpoint and folder of the cell.

    Attributes:
        site: First part of the cell's name on the bus.
        name: Second part of the cell's name on the bus.
        endpoint: Endpoint at which the daemon's bus router listens.
        rate: Seconds of the cell per second of the machine; more than 1 only with simulated devices.
        folder: Folder of journal and records; empty for ``pcmrs/<site>-<name>`` in the user's state folder.
    """

    site: str = "lab"
    name: str = "cell1"
    endpoint: str = "tcp/127.0.0.1:7447"
    rate: Annotated[float, msgspec.Meta(ge=1.0, le=50.0)] = 1.0
    folder: str = ""

    def path(self) -> Path:
        """Return the path of the folder."""
        if self.folder:
            return Path(self.folder).expanduser()
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        return Path(state) / "pcmrs" / f"{self.site}-{self.name}"

    def journal(self, workflow: str) -> Path:
        """Return the path of a workflow's journal; `workflow` is the id of its blueprint."""
        return self.path() / f"{workflow}{JOURNAL_SUFFIX}"

    def stored_journal(self, workflow: str) -> Path:
        """Return the journal to read: that of a workflow, or the only one in the folder.

        Args:
            workflow: Id of the blueprint of the configured workflow.

        Returns:
            Path of the journal; it is missing if the folder has none.

        Raises:
            ConfigurationError: The folder has journals of several other workflows.
        """
        own = self.journal(workflow)
        others = sorted(self.path().glob(f"*{JOURNAL_SUFFIX}"))
        if own.exists() or not others:
            return own
        if len(others) > 1:
            names = ", ".join(path.stem for path in others)
            text = f"{self.path()} has no journal of the workflow {workflow}, but those of {names}: "
            raise ConfigurationError(f"{text}add --set workflow=NAME with one of them.", folder=str(self.path()))
        return others[0]


class DeviceSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Settings of a device.

    Attributes:
        driver: Name of its driver; ``none`` if another machine runs its node, or if there is no such device.
    """

    driver: str = "sim"


class TrackerSettings(DeviceSettings, frozen=True, forbid_unknown_fields=True):
    """The tracker.

    Attributes:
        beeps: True if its beeper sounds for the person with the pointer: 3 beeps when a touch is awaited, 2 for each
            landmark that is taken, 5 after points of the skin. Trackers without a beeper stay silent.
    """

    beeps: bool = False


class PointerSettings(DeviceSettings, frozen=True, forbid_unknown_fields=True):
    """The pointer; its driver ``dwell`` needs no device: the tip touches where the tracker sees it held still.

    Attributes:
        dwell: Conditions of a touch.
    """

    dwell: DwellSettings = DwellSettings()


class RobotSettings(DeviceSettings, frozen=True, forbid_unknown_fields=True):
    """The arm.

    Attributes:
        model: Name of a model (`find_arm`), or path of a URDF file.
        force_limit: Force on the tool above which the driver stops the arm, N.
        relief_mm: Longest travel by which the driver first draws the tool back along its axis to relieve the force, mm.
        deadman: Time without a heartbeat of the daemon after which the node holds the moving arm by itself, s of the
            machine; also the time after its last set point at which a servo session ends.
    """

    model: str = "iiwa14"
    force_limit: Annotated[float, msgspec.Meta(gt=0.0)] = 25.0
    relief_mm: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.1


class AccessSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Access to the cell from other machines; there is none without an identity.

    Attributes:
        identity: Folder that ``pcmrs pki issue`` has made for this process; empty for this machine only.
        register: Copy of the authority's register: everyone who may take part, with role and cells.
        listen: Endpoints at which others connect to this cell, such as ``tls/0.0.0.0:7448``.
        routers: Routers that this cell connects to, such as ``tls/router.example.org:7449``.
        device_key: File of the key that daemon and device nodes of other machines share, made by ``pcmrs pki
            device-key``. Empty: the daemon makes a new key at each start, for the nodes that it starts itself.
        lease_s: Time without a renewal after which a remote holder loses the cell, s.
    """

    identity: str = ""
    register: str = ""
    listen: tuple[str, ...] = ()
    routers: tuple[str, ...] = ()
    device_key: str = ""
    lease_s: Annotated[float, msgspec.Meta(ge=3.0, le=600.0)] = 10.0

    @property
    def is_open(self) -> bool:
        """True if other machines may reach the cell: then a user has to hold it."""
        return bool(self.identity)

    def credentials(self) -> Credentials | None:
        """Read and check the identity; None if none is configured. Raises `ConfigurationError`."""
        return read_credentials(Path(self.identity), SystemClock().wall()) if self.identity else None

    def read_device_key(self) -> bytes | None:
        """Read the key in the file `device_key`; None if none is configured. Raises `ConfigurationError`."""
        return read_key(Path(self.device_key)) if self.device_key else None

    def members(self) -> tuple[Identity, ...]:
        """Read the register. Raises `ConfigurationError`."""
        return tuple(read_register(Path(self.register))) if self.register else ()


class JournalSettings(Table, frozen=True, forbid_unknown_fields=True):
    """The journal.

    Attributes:
        durable: If False, decisions survive a kill but not a power cut: for benchmarks.
        largest_mb: Size beyond which the journal continues in a new file, MB.
        warn_free_mb: Free space on its disk below which the daemon warns, MB.
        least_free_mb: Free space below which no state change is accepted any more, MB. There is still room for Stop,
            events and running operations.
    """

    durable: bool = True
    largest_mb: Annotated[float, msgspec.Meta(gt=0.0)] = 256.0
    warn_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 1000.0
    least_free_mb: Annotated[float, msgspec.Meta(ge=0.0)] = 100.0


class MetricsSettings(Table, frozen=True, forbid_unknown_fields=True):
    """Metrics for Prometheus over HTTP, on loopback only.

    Attributes:
        port: TCP port; 0 for a free one. None: no metrics are served.
    """

    port: Annotated[int, msgspec.Meta(ge=0, le=65535)] | None = None


class Settings(Table, frozen=True, forbid_unknown_fields=True):
    """The root of the configuration.

    Attributes:
        schema: Version of the format of the configuration; a later one is refused.
        workflow: Name of a workflow, or path of its blueprint: ``something.toml``.
        cell: Name, endpoint and folder of the cell.
        robot: The arm.
        tracker: The tracker.
        pointer: The pointer.
        scene: The simulated scene.
        stimulator: The stimulator.
        emg: The electromyograph.
        procedure: Parameters of the procedure.
        scene_events: Sources of scene events, and what each label calls.
        scene_camera: Depth camera of the detector `pcmrs-scene`.
        gateway: Links of the gateway, and its peers.
        access: Access to the cell from other machines.
        journal: The journal.
        recording: Recording of sessions.
        metrics: Metrics for Prometheus.
        console: The console's page.
        sim: Table of the driver ``sim``.
        kst: Table of the driver ``kst``.
        ndi: Table of the driver ``ndi``.
        plus: Table of the driver ``plus``.
        lsl: Table of the driver ``lsl``.
        trigger: Table of the driver ``trigger``.
        ros2: Table of the driver ``ros2``.
    """

    schema: int = SCHEMA
    workflow: str = "ratms"
    cell: CellSettings = CellSettings()
    robot: RobotSettings = RobotSettings()
    tracker: TrackerSettings = TrackerSettings()
    pointer: PointerSettings = PointerSettings()
    scene: DeviceSettings = DeviceSettings()
    stimulator: DeviceSettings = DeviceSettings()
    emg: DeviceSettings = DeviceSettings()
    procedure: ProcedureSettings = ProcedureSettings()
    scene_events: SceneEventSettings = SceneEventSettings()
    scene_camera: SceneCameraSettings = SceneCameraSettings()
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
        """Return the devices that each driver's node serves, without those that another machine serves."""
        found: dict[str, list[str]] = {}
        for device in DEVICES:
            driver = getattr(self, device).driver
            if driver not in ("none", DWELL):
                found.setdefault(driver, []).append(device)
        return found

    def has_simulated_tool(self, with_robot: bool) -> bool:
        """Return True if the tool is that of the simulated cell, also through virtual devices that this cell serves.

        Args:
            with_robot: False to look at the tracker only.
        """
        kst, ndi = self.kst.get("host", "127.0.0.1"), str(self.ndi.get("device", "127.0.0.1:8765"))
        virtual = {
            SIMULATED: True,
            "kst": is_this_machine(kst),
            "ndi": is_this_machine(ndi.rpartition(":")[0]) or ndi.startswith("/dev/pts/"),
        }
        used = [self.tracker, self.robot] if with_robot else [self.tracker]
        return self.scene.driver == SIMULATED and all(virtual.get(device.driver, False) for device in used)

    @property
    def point_to_point(self) -> bool:
        """True if the arm can only be moved from point to point, and not be stopped on the way."""
        return self.robot.driver == "kst" and self.kst.get("motion") == "ptp"

    def bus(self, mode: str) -> BusSettings:
        """Return the bus settings of a process: `mode` is ``router`` for the daemon, ``client`` for others.

        Raises:
            ConfigurationError: The identity or the register cannot be used, or a peer of the gateway has a name of the
                register.
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
        _check_peers(self.gateway.peers, members)
        return msgspec.structs.replace(
            as_client, mode="router", listen=access.listen, routers=access.routers, members=members
        )


class Inherited(msgspec.Struct, frozen=True, kw_only=True):
    """Data that a child process of the daemon gets on its standard input, as one line of JSON.

    Attributes:
        settings: Settings of the daemon.
        device_key: Key with which daemon and nodes seal their messages; empty for a child that only reads.
    """

    settings: Settings
    device_key: bytes = b""


def read_settings(file: Path | None = None, overrides: Sequence[str] = ()) -> Settings:
    """Read and check the whole configuration: defaults of the workflow, overridden by a file and by single values.

    Args:
        file: TOML file; the path of a workflow, an arm, a calibration or the lab's files in it is relative to its
            folder.
        overrides: Settings, ``key=value`` each; such a path there is relative to the working directory.

    Raises:
        ConfigurationError: A key is unknown or a value cannot be used; the text names it and what to do.
    """
    values = _values(file, overrides)
    _check_schema(values.get("schema", SCHEMA))
    defaults = _defaults_of(values)
    settings = as_config(Settings, merge_tables(defaults, values), where=_locations(file, overrides))
    _check_limits(settings, defaults)
    _check_cell(settings)
    simulated = SIMULATED in settings.drivers()
    if not simulated and SIMULATED not in values:
        # Without a simulation its defaults in the workflow are not used, and it need not be installed.
        settings = msgspec.structs.replace(settings, sim={})
    if simulated:
        _check_driver_tables({SIMULATED: defaults.get(SIMULATED, {})}, f" in {_origin(settings.workflow)}")
    used = settings.drivers().keys() | values.keys()
    _check_driver_tables({driver: getattr(settings, driver) for driver in TABLES if driver in used})
    return settings


def _check_schema(found: object) -> None:
    """Refuse a configuration of a later version before its keys, of which some are then unknown."""
    if found != SCHEMA:
        text = f"The configuration has schema {found!r}, and this version of PCMRS reads {SCHEMA}: use the version "
        raise ConfigurationError(f"{text}that it was written for, or a later one.", schema=found, limit=SCHEMA)


def _values(file: Path | None, overrides: Sequence[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if file is not None:
        values = read_file(file)
        _resolve_paths(values, file.absolute().parent)
    set_values(values, overrides)
    _resolve_paths(values, Path.cwd())
    return values


def _locations(file: Path | None, overrides: Sequence[str]) -> Where:
    """Return a function that tells where a key was set; the file is read when it is called first."""

    @functools.cache
    def places() -> Places | None:
        try:
            return None if file is None else read_toml(file.read_bytes(), str(file))[1]
        except (BlueprintError, OSError):  # longer than any workflow, or gone since it was read
            return None

    def where(path: tuple[str, ...]) -> str:
        for key, _, _ in (each.partition("=") for each in overrides):
            if path[: key.count(".") + 1] == tuple(key.split(".")):
                return f"--set {key}"
        known = places()
        if known is None:
            return ""
        name, line, column = known.of(path)
        return f"{name}:{line}:{column}"

    return where


def _resolve_paths(values: dict[str, Any], folder: Path) -> None:
    """Make the paths of workflow, arm, calibrations, the lab's files and secrets absolute, relative to `folder`."""
    procedure = values.get("procedure")
    calibration = procedure.get("calibration") if isinstance(procedure, dict) else None
    access = values.get("access")
    for table, key, ending in (
        (values, "workflow", ".toml"),
        (values.get("robot"), "model", ".urdf"),
        (calibration, "tool_file", ".toml"),
        (calibration, "tip_file", ".toml"),
        (calibration, "pointer_file", ".toml"),
        (values.get("gateway"), "lab_files", ""),
        (access, "identity", ""),
        (access, "register", ""),
    ):
        if isinstance(table, dict) and isinstance(name := table.get(key), str) and name and name.endswith(ending):
            table[key] = str(folder / Path(name).expanduser())


def _defaults_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the workflow's defaults, checked separately so that errors name its blueprint."""
    name = values.get("workflow", Settings().workflow)
    if not isinstance(name, str):
        return {}  # refused later, with the other values
    defaults = read_workflow(name).defaults
    origin = _origin(name)
    as_config(Settings, defaults, origin)
    changed = {*defaults} - {"procedure"} | {f"procedure.{table}" for table in defaults.get("procedure", {})}
    for table in sorted(changed - WORKFLOW_TABLES):
        text = f"{origin} sets {table}; a workflow may change {', '.join(sorted(WORKFLOW_TABLES))} only."
        raise ConfigurationError(text, table=table)
    return defaults


def _origin(workflow: str) -> str:
    return f"The table [defaults] of {find_workflow(workflow).blueprint}"


def _check_limits(settings: Settings, defaults: Mapping[str, Any]) -> None:
    known = defaults.get("procedure", {}).get("limits", {})
    for name in sorted(settings.procedure.limits.keys() - known):
        text = f"procedure.limits.{name} is not a limit of {settings.workflow}; it has {', '.join(known) or 'none'}."
        raise ConfigurationError(text, limit=name)


def _check_cell(settings: Settings) -> None:
    """Check name, arm and drivers, beyond what the types check."""
    try:
        cell_prefix(settings.cell.site, settings.cell.name)
    except PayloadError as error:
        raise ConfigurationError(f"cell.site and cell.name: {error.text}", **error.fields) from None
    _check_home(settings.procedure.home, find_arm(settings.robot.model))
    known = {point.name for point in entry_points_of(DRIVERS)}
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


def _check_peers(peers: Iterable[str], members: Iterable[Identity]) -> None:
    """Refuse a peer with the name of a member: lease and journal know users by their names only.

    The names of revoked members count, too: rows of the journal name them.

    Raises:
        ConfigurationError: A peer has the name of a member.
    """
    known = {member.name for member in members}
    for peer in peers:
        if peer.lower() in known:
            text = (
                f"gateway.peers holds {peer!r}, and the register has {peer.lower()!r}: both would count as one user. "
                "Choose another name for the peer, here and in its client."
            )
            raise ConfigurationError(text, peer=peer)


def _check_dwell(settings: Settings) -> None:
    wrong = [device for device in DEVICES if device != "pointer" and getattr(settings, device).driver == DWELL]
    if wrong:
        text = f"The driver {DWELL!r} serves the pointer, not {', '.join(wrong)}; choose another driver there."
        raise ConfigurationError(text, devices=wrong)


def _check_home(home: tuple[float, ...], arm: ArmFacts) -> None:
    if len(home) not in (0, len(arm.joints)):  # empty: the default posture of the arm
        text = f"procedure.home holds {len(home)} numbers; {arm.name} has {len(arm.joints)} joints."
        raise ConfigurationError(text, home=list(home))


def _check_driver_tables(tables: Mapping[str, Mapping[str, Any]], where: str = "") -> None:
    """Check the table of each driver with the type that the driver declares for it."""
    for point in entry_points_of(DRIVER_SETTINGS):
        if point.name in tables:
            try:
                msgspec.convert(tables[point.name], point.load())
            except ImportError as error:
                raise ConfigurationError(f"The driver {point.name!r} is not installed: {error}") from None
            except msgspec.ValidationError as error:
                raise ConfigurationError(f"The table [{point.name}]{where} is wrong: {error}.") from None
