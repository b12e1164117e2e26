"""Search for the hot-spot: the next pose, and the use of the response there."""

from __future__ import annotations

import msgspec

from pcmrs.dispatcher import Registry
from pcmrs.errors import RefusalError
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Transform
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.settings import Count, HotspotMethod, HotspotSettings
from pcmrs.workflows._correction import size_mm_deg
from pcmrs.workflows._placement import planned_pose
from pcmrs.workflows.cell import Cell
from pcmrs.workflows.data import PlacementData, as_transform
from pcmrs.workflows.tms.data import Response, Run
from pcmrs.workflows.tms.intensity import known_intensity
from pcmrs.workflows.toolplan import ToolPose, accept_pose, pose_of


class AskedSearch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Arguments of `hotspot.begin`. Omitted ones are as configured.

    Attributes:
        centre: ``image_from_coil`` in the middle of the region; None for the plan in force.
        method: Method by which places are chosen.
        rings: Number of rings of the region around the centre.
        max_pulses: Greatest number of pulses of an adaptive search.
    """

    centre: ToolPose | None = None
    method: HotspotMethod | None = None
    rings: Count | None = None
    max_pulses: Count | None = None


def search_possible(run: Run) -> None:
    """Prepare a search on the body's surface, or refuse if there is no surface or the centre does not fit it."""
    arguments, settings = run.payload, run.cell.settings.stimulation.hotspot
    given = {"method": arguments.method, "rings": arguments.rings, "max_pulses": arguments.max_pulses}
    chosen = {key: value for key, value in given.items() if value is not None}
    try:
        changed = msgspec.convert(msgspec.to_builtins(settings) | chosen, HotspotSettings)
    except msgspec.ValidationError as error:
        raise RefusalError("bad_arguments", f"hotspot.begin: {error}.") from None
    centre = planned_pose(run.data) if arguments.centre is None else pose_of(arguments.centre)
    run.prepared = HotspotSearch.begin(changed, _scalp(run).closest, centre)


def _scalp(run: Run) -> TriangleSurface:
    mesh = run.cell.surface
    if mesh is None:
        text = "procedure.body.surface names no surface of the body: a search needs the scalp. Configure it."
        raise RefusalError("no_surface", text)
    return TriangleSurface(mesh.vertices, mesh.faces)


def begin_search(run: Run) -> None:
    """Put the search in force."""
    search: HotspotSearch = run.prepared
    run.keep(search=search, search_intensity=run.data.intensity, hotspot=None)
    run.result |= {
        "intensity": run.data.intensity,
        "method": search.settings.method,
        "next": msgspec.to_builtins(search.next()),
    }


def search_pose_reachable(run: Run) -> None:
    """Prepare the next pose, or the hot-spot, as the plan; refuse a pose that the arm cannot reach."""
    accept_pose(run, _pose_of(run))


def plan_is_of_search(run: Run) -> None:
    """Refuse a pulse if the plan in force is neither the next pose of the search nor a neighbour of it."""
    settings, proposed, plan = _search_of(run).settings, _pose_of(run), planned_pose(run.data)
    shift_mm, turn_deg = size_mm_deg(proposed.inverse() @ plan)
    # A neighbour is accepted, because the arm may not reach the proposed pose.
    if shift_mm > settings.spacing_mm or turn_deg > settings.heading_step_deg:
        text = (
            f"The plan in force is {shift_mm:.1f} mm and {turn_deg:.0f}° from the pose that the search proposes; the "
            f"limits are {settings.spacing_mm:g} mm and {settings.heading_step_deg:g}°. Send toolplan.aim_hotspot; "
            "if the arm cannot reach that pose, plan one beside it. Then approach."
        )
        raise RefusalError("other_pose_planned", text, shift_mm=shift_mm, turn_deg=turn_deg)


def intensity_is_of_search(run: Run) -> None:
    """Refuse a pulse of another intensity than that of the search, because such responses cannot be compared."""
    percent, required = known_intensity(run.data), run.data.search_intensity
    if percent != required:
        text = f"The search was started at {required:g} %, and {percent:g} % is set. Set {required:g} %, or restart it."
        raise RefusalError("intensity_changed", text, intensity=percent, search_intensity=required)


def _pose_of(run: Run) -> Transform:
    return as_transform(_search_of(run).next() if run.data.hotspot is None else run.data.hotspot)


def learn_place(run: Run) -> None:
    """Add the response to the search. A pulse without a valid response is repeated at the same place."""
    response: Response = run.prepared
    search = _search_of(run)
    if response.mep is not None and not response.problem:
        search = search.after(response.coil, response.mep.peak_to_peak)
        run.keep(search=search)
    run.outcome = "searching" if not search.finished else "found" if search.responded else "none"
    run.result["pulses"] = len(search.pulses)
    if run.outcome == "found":
        keep_hotspot(run)
    elif run.outcome == "none":
        run.result["refusal"] = "no_response"


def place_known(run: Run) -> None:
    """Refuse to conclude a search without any result."""
    _ = _search_of(run).estimate


def keep_hotspot(run: Run) -> None:
    """Put the best present estimate of the hot-spot on record."""
    found = _search_of(run).estimate
    run.keep(hotspot=found.image_from_coil)
    run.result["hotspot"] = msgspec.to_builtins(found)


def _search_of(run: Run) -> HotspotSearch:
    """Return the active search. Raises `RefusalError` if there is none."""
    if run.data.search is None:
        raise RefusalError("no_search", "There is no search for a hot-spot: send hotspot.begin first.")
    return run.data.search


def register_hotspot(registry: Registry[Cell, PlacementData]) -> None:
    """Register the names that blueprints use for these checks and steps."""
    registry.payload("hotspot_search", AskedSearch)
    registry.long_check(search_pose_reachable)
    for check in (search_possible, plan_is_of_search, intensity_is_of_search, place_known):
        registry.check(check)
    for step in (begin_search, learn_place, keep_hotspot):
        registry.step(step)
