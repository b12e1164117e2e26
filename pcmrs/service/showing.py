"""What a console is told of the cell: how it is set up, and what its procedure has gathered."""

from __future__ import annotations

from itertools import zip_longest

from pcmrs.fsm import Blueprint
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.messages.setup import ArmShown, BoxShown, Gathered, LandmarkShown, Setup, SurfaceShown
from pcmrs.settings import Settings
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message
from pcmrs.workflows.surface import read_surface


def setup_of(cell: Cell, settings: Settings, blueprint: Blueprint) -> Setup:
    """How the cell is set up, for nobody in particular. Reads the file of the surface.

    Raises:
        ConfigurationError: The body's surface is not there any more.
        FileFormatError: It is no mesh any more.
    """
    procedure, facts = settings.procedure, cell.arm.facts
    mesh = read_surface(procedure)
    surface = None
    if mesh is not None:
        surface = SurfaceShown(vertices=mesh.vertices.astype("<f4").tobytes(), faces=mesh.faces.astype("<u4").tobytes())
    return Setup(
        user="",
        role="viewer",
        lease_required=settings.access.is_open,
        blueprint=blueprint_toml(blueprint),
        arm=ArmShown(
            name=facts.name,
            joints=[as_message(joint.parent_from_joint) for joint in facts.joints],
            flange=as_message(facts.joint_from_flange),
            link_radius=facts.link_radius,
        ),
        flange_from_coil=as_message(cell.flange_from_coil),
        tool_radius=procedure.zones.tool.radius,
        tool_half_length=procedure.zones.tool.half_length,
        boxes=[
            BoxShown(name=each.name, pose=as_message(each.pose.transform()), size=each.size)
            for each in procedure.zones.boxes
        ],
        surface=surface,
        patient=procedure.patient,
        operator=procedure.operator,
        residual_limit=procedure.registration.residual_limit_mm / 1000.0,
        drivers={device: driver for driver, devices in settings.drivers().items() for device in devices},
    )


def gathered(data: PlacementData) -> Gathered:
    """What the procedure has gathered so far."""
    registered = data.registered
    return Gathered(
        landmarks=[
            LandmarkShown(name=each.name, planned=each.position, digitized=point)
            for each, point in zip_longest(data.landmarks, data.digitized)
        ],
        body_ref_from_image=None if registered is None else registered.body_ref_from_image,
        residual=None if registered is None else registered.residual,
        plan=data.plan,
    )
