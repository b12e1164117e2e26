"""View of the cell for a console: its setup, and the data of its procedure."""

from __future__ import annotations

from itertools import zip_longest

import msgspec

from pcmrs.dispatcher import Workflow
from pcmrs.dispatcher.arguments import arguments_shown
from pcmrs.fsm.files.dump import blueprint_toml
from pcmrs.messages.setup import (
    ArmShown,
    BoxShown,
    LandmarkShown,
    ProcedureDataView,
    Setup,
    SliceShown,
    SurfaceShown,
)
from pcmrs.settings import Settings
from pcmrs.workflows.accuracy import active_noise_sigma
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_message


def setup_of(cell: Cell, settings: Settings, workflow: Workflow[Cell, PlacementData]) -> Setup:
    """Return how the cell is set up.

    Args:
        cell: The cell.
        settings: The whole configuration.
        workflow: The workflow.
    """
    procedure, facts, mesh = settings.procedure, cell.arm.facts, cell.surface
    surface = None
    if mesh is not None:
        surface = SurfaceShown(vertices=mesh.vertices.astype("<f4").tobytes(), faces=mesh.faces.astype("<u4").tobytes())
    return Setup(
        user="",
        role="viewer",
        lease_required=settings.access.is_open,
        blueprint=blueprint_toml(workflow.blueprint),
        arm=ArmShown(
            name=facts.name,
            joints=[as_message(joint.parent_from_joint) for joint in facts.joints],
            flange=as_message(facts.joint_from_flange),
            link_radius=facts.link_radius,
        ),
        flange_from_coil=as_message(cell.flange_from_tool_tip),
        tool_marker_from_tool_tip=as_message(cell.mounting.tool_marker_from_tool_tip),
        tool_radius=procedure.zones.tool.radius,
        tool_half_length=procedure.zones.tool.half_length,
        boxes=[
            BoxShown(name=each.name, pose=as_message(each.pose.transform()), size=each.size)
            for each in procedure.zones.boxes
        ],
        surface=surface,
        patient=procedure.patient,
        operator=procedure.operator,
        confirm_offset=procedure.placement.confirm_offset,
        residual_limit=procedure.registration.residual_limit_mm / 1000.0,
        drivers={device: driver for driver, devices in settings.drivers().items() for device in devices},
        body_margin=procedure.zones.body_margin,
        tre_limit=procedure.registration.tre_limit_mm / 1000.0,
        volume=[SliceShown(**msgspec.to_builtins(each)) for each in procedure.tracking.volume],
        mep=msgspec.to_builtins(procedure.stimulation.mep),
        point_to_point=settings.point_to_point,
        arguments=arguments_shown(workflow.registry.payloads),
    )


def gathered(cell: Cell, data: PlacementData) -> ProcedureDataView:
    """Return the present data of the procedure, for people.

    Args:
        cell: The cell.
        data: Data of the procedure.
    """
    registered = data.registered
    return ProcedureDataView(
        landmarks=[
            LandmarkShown(name=each.name, planned=each.position, digitized=point)
            for each, point in zip_longest(data.landmarks, data.digitized)
        ],
        body_ref_from_image=None if registered is None else registered.body_ref_from_image,
        residual=None if registered is None else registered.residual,
        plan=data.plan,
        sigma=active_noise_sigma(cell, data),
        covariance=[] if registered is None else list(registered.covariance),
        stimulation=data.stimulation_view(),
    )
