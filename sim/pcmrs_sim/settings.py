"""Settings of the simulated cell: its errors and its geometry."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec

from pcmrs.errors import ConfigurationError, GeometryError
from pcmrs.spatial import Transform

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]


class ConfiguredPose(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A transform ``a_from_b`` in a configuration.

    Attributes:
        position: Translation, m.
        quat_wxyz: Unit quaternion.

    Raises:
        ValueError: The quaternion does not have unit length, or a number is not finite.
    """

    position: Triple = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        try:
            _ = self.transform
        except GeometryError as error:
            raise ValueError(error.text) from None  # to which msgspec adds the key

    @property
    def transform(self) -> Transform:
        """This pose as a `Transform`."""
        return Transform.from_quat_wxyz(self.position, self.quat_wxyz)


class TrackerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The optical tracker's errors and timing.

    Attributes:
        rate_hz: Frames per second of cell time.
        latency: Age of a pose when it is published, s.
        jitter_mm: Standard deviation of a marker sphere 1 m away, per frame and axis across its line of sight. It grows
            with the distance; along the line of sight it is larger, and grows with the square.
        bias_mm: Root mean square magnitude of the translation bias, fixed per seed and place.
        bias_deg: Root mean square magnitude of the rotation bias, fixed per seed and place.
        nearest: Smallest distance at which a sphere is measured, along the direction in which the tracker looks, m.
        farthest: Largest distance.
        half_width: Half width and half height of the measuring volume at a distance, as a fraction of it. The default
            is wider than that of a real tracker, so that the tool is measured in its home posture, too.
    """

    rate_hz: Positive = 60.0
    latency: NotNegative = 0.030
    jitter_mm: NotNegative = 0.005
    bias_mm: NotNegative = 0.10
    bias_deg: NotNegative = 0.03
    nearest: NotNegative = 0.5
    farthest: Positive = 2.4
    half_width: Positive = 0.9


class DigitizationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The person with the pointer. The first two deviations combine to 1.86 mm per axis, as on a head.

    Attributes:
        planning_bias_mm: Standard deviation per axis of the planned landmark from the anatomical point that the person
            touches; fixed per seed and landmark.
        noise_mm: Standard deviation per axis of each touch.
        surface_noise_mm: Standard deviation per axis of a point touched anywhere on the skin.
        reach_time: Time from the prompt until the tip rests on the landmark, s.
        rest_time: Time from then until the person reports it, s; longer than the tracker's latency.
    """

    planning_bias_mm: NotNegative = 1.6
    noise_mm: NotNegative = 0.95
    surface_noise_mm: NotNegative = 0.5
    reach_time: NotNegative = 0.8
    rest_time: NotNegative = 0.2


class ArmSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The arm's imperfections and its controller.

    Attributes:
        home: Posture at the start, rad, base to flange; empty for the default of the arm.
        friction: Coulomb friction of each joint, N m.
        damping: Viscous friction of each joint, N m s/rad.
        armature: Rotor inertia of each joint seen at its output, kg m^2; known to the controller.
        geometry_error_mm: Root mean square distance of the true flange from its nominal position, over postures and
            seeds; fixed per seed.
        repeatability_mm: Pose repeatability as data sheets give it (ISO 9283): after each motion the tool rests at
            another place, which the joints do not show. 0 for none.
        inertia_error: Relative error of the controller's masses and inertias, with a random sign for each link.
        stiffness: Stiffness of the joint impedance, base to flange, N m/rad; empty for the default of the arm.
        integral_rate: Rate at which the integral action removes a constant error, 1/s.
        brake_acceleration: Acceleration of each joint while the arm brakes, rad/s^2.
        brake_jerk: Jerk of each joint while the arm brakes, rad/s^3.
        force_noise: Standard deviation of the measured force per axis and control step, N, before the filter.
        force_filter_hz: Corner frequency of the low-pass filter of the measured force.
        state_rate_hz: Published joint states per second of cell time.
        physics: ``mujoco``, or ``kinematic``: the arm is always exactly on its reference, costs almost no time, and
            meets the body as a spring without noise. Friction, inertias, controller and sensor are then not used.
    """

    physics: Literal["mujoco", "kinematic"] = "mujoco"
    home: tuple[float, ...] = ()
    friction: NotNegative = 0.5
    damping: NotNegative = 0.5
    armature: NotNegative = 0.1
    geometry_error_mm: NotNegative = 1.0
    repeatability_mm: NotNegative = 0.0
    inertia_error: Annotated[float, msgspec.Meta(ge=0.0, lt=1.0)] = 0.05
    stiffness: tuple[Positive, ...] = ()
    integral_rate: NotNegative = 8.0
    brake_acceleration: Positive = 10.0
    brake_jerk: Positive = 200.0
    force_noise: NotNegative = 0.2
    force_filter_hz: Positive = 20.0
    state_rate_hz: Positive = 100.0


class SkinSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The skin between tool and body.

    Attributes:
        stiffness: Stiffness of the spring, N/m.
        damping: Fraction of the spring's force that is added per speed of the tool into the body, s/m.
    """

    stiffness: NotNegative = 1000.0
    damping: NotNegative = 5.0


class GeometrySettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """True poses. The robot base is the world frame.

    Attributes:
        world_from_tracker: Pose of the camera, 1.2 m from the patient. It looks along its -z, as optical trackers do.
        world_from_image: Pose of the patient; absent for the default of the phantom.
        body_ref_from_image: Pose of the image in the patient's marker body: the true registration, which the product
            does not know. Absent for the default of the phantom.
        flange_from_tool_tip: Contact point and axes of the tool on the flange; +z points away from the patient, back
            along the arm.
        tool_marker_from_tool_tip: Contact point and axes of the tool in its marker body, which the tracker sees: 90 mm
            away, and rotated about all axes.
        pointer_from_tip: Pose of the tip in the pointer's marker body.
    """

    world_from_tracker: ConfiguredPose = ConfiguredPose((1.35, -0.5, 0.6), (0.744115, 0.434873, 0.255881, 0.43784))
    world_from_image: ConfiguredPose | None = None
    body_ref_from_image: ConfiguredPose | None = None
    flange_from_tool_tip: ConfiguredPose = ConfiguredPose((0.0, 0.0, 0.15), (0.0, 1.0, 0.0, 0.0))
    tool_marker_from_tool_tip: ConfiguredPose = ConfiguredPose((0.06, 0.03, -0.06), (0.8, 0.4, 0.2, 0.4))
    pointer_from_tip: ConfiguredPose = ConfiguredPose((0.0, 0.0, -0.15))


class StimulatorSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The magnetic stimulator and its coil; temperatures in degrees Celsius.

    Attributes:
        charge_time: Time from the command to arm until it is armed, s.
        recharge_time: Time from a pulse until the next one is possible, s.
        armed_time: Time after which it disarms if no pulse was given, s.
        ambient: Temperature of the room.
        hottest: Temperature of the coil at which it disarms.
        heat: Rise of the coil's temperature by a pulse at full output. It scales with the square of the intensity.
        cooling_time: Time constant of the cooling, s.
    """

    charge_time: NotNegative = 1.0
    recharge_time: NotNegative = 0.5
    armed_time: Positive = 60.0
    ambient: float = 22.0
    hottest: float = 40.0
    heat: NotNegative = 0.08
    cooling_time: Positive = 600.0


class MuscleSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The electromyogram of the muscle that responds to the stimulator.

    Attributes:
        rate_hz: Samples per second.
        latency: Time from a pulse to the onset of the response, s.
        scale: Time scale of the response, s. The response lasts six times as long.
        noise_uv: Standard deviation of the noise.
        hum_hz: Frequency of the mains, 50 or 60.
        hum_uv: Amplitude of the mains hum.
        preactivation_uv: Standard deviation of the activity of a muscle that is not relaxed.
        artefact_mv: Amplitude of the stimulus artefact at full output.
        artefact_decay: Time constant of the artefact, s.
        full_scale_mv: Magnitude at which the amplifier saturates.
        streamed: Stream on Lab Streaming Layer if ``emg.driver`` is ``lsl``; set it to false with a real amplifier.
    """

    rate_hz: Annotated[int, msgspec.Meta(ge=100)] = 5000
    latency: NotNegative = 0.021
    scale: Positive = 0.0025
    noise_uv: NotNegative = 2.0
    hum_hz: Positive = 50.0
    hum_uv: NotNegative = 3.0
    preactivation_uv: NotNegative = 0.0
    artefact_mv: NotNegative = 3.0
    artefact_decay: Positive = 0.0008
    full_scale_mv: Positive = 10.0
    streamed: bool = True


class SimSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``sim`` of the configuration.

    Attributes:
        seed: Seed of all simulated errors; `Scene.reseed` replaces it.
        phantom: The body in front of the robot, which also decides the tool.
    """

    seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    phantom: Literal["head", "femur"] = "head"
    tracker: TrackerSettings = TrackerSettings()
    digitization: DigitizationSettings = DigitizationSettings()
    arm: ArmSettings = ArmSettings()
    contact: SkinSettings = SkinSettings()
    geometry: GeometrySettings = GeometrySettings()
    stimulator: StimulatorSettings = StimulatorSettings()
    muscle: MuscleSettings = MuscleSettings()


def read_settings(settings: Mapping[str, Any]) -> SimSettings:
    """Return the table ``sim`` of the whole configuration; all defaults if it is absent.

    Raises:
        ConfigurationError: A key is unknown, or a value has the wrong type or is out of range.
    """
    try:
        return msgspec.convert(settings.get("sim", {}), SimSettings)
    except msgspec.ValidationError as error:
        raise ConfigurationError(f"The table [sim] of the configuration is wrong: {error}.") from None
