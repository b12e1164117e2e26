"""`pcmrs skin`: the surface of a body in a volume, as a mesh for the configuration of a cell."""

from __future__ import annotations

from pathlib import Path

import click

from pcmrs.cli.options import OutputFile, json_option
from pcmrs.cli.printing import say, say_json
from pcmrs.cli.progress import progress_bar
from pcmrs.cli.running import readable_errors

SMALLEST_MM, LARGEST_MM = 100.0, 1000.0
"""Range of the longest edge of a plausible body, mm: a head has 200 to 300, a femur 400 to 500. A smaller one is often
only a part, such as the teeth, or comes from voxels of a wrong size."""


@click.command()
@click.argument("volume", type=click.Path(path_type=Path, exists=True))
@click.option("-o", "--output", type=OutputFile(), required=True, metavar="FILE.ply", help="File for the mesh.")
@click.option("--threshold", type=float, help="Grey value of the surface; by default Otsu's, which suits skin in air.")
@click.option("--any-size", is_flag=True, help="Write a body of an implausible size without a question.")
@json_option
@readable_errors
def skin(volume: Path, output: Path, threshold: float | None, any_size: bool, as_json: bool) -> None:
    """Extract the outer surface of the body in VOLUME: a NIfTI file, or a folder with one DICOM series.

    The mesh is in RAS and m, as procedure.body.surface needs it. Check it before you plan on it. A body whose longest
    edge is below 100 mm or above 1000 mm is written only if you confirm it.

    Exit status: 0 written, 5 the volume cannot be read or holds no such surface or no such body, 4 a package is
    missing.

    Example: pcmrs skin head.nii.gz -o head.ply
    """
    from trimesh import Trimesh

    from pcmrs.formats.reading import refuse
    from pcmrs.formats.skin import skin_of
    from pcmrs.formats.volume import read_volume

    if output.suffix.lower() not in (".ply", ".stl"):
        refuse(output, "would not be a mesh that can be read: end its name in .ply or .stl.")
    with progress_bar(transient=True) as show:
        show("read", 0, 1)
        mesh = skin_of(read_volume(volume), threshold, show)
    solid = Trimesh(mesh.vertices, mesh.faces, process=False)
    edges_mm: list[float] = (1000.0 * (solid.bounds[1] - solid.bounds[0])).round(1).tolist()
    extent = " x ".join(f"{edge:.1f}" for edge in edges_mm)
    if not any_size and not SMALLEST_MM <= max(edges_mm) <= LARGEST_MM and not _is_confirmed(extent):
        refuse(output, f"was not written: a body of {extent} mm. Check the size of the voxels, or give --threshold.")
    solid.export(output)
    found = {"file": str(output), "faces": len(mesh.faces), "edges_mm": edges_mm, "closed": bool(solid.is_watertight)}
    if as_json:
        say_json(found)
        return
    closed = "closed" if solid.is_watertight else "not closed"
    say(f"{output}: {len(mesh.faces)} triangles, {closed}, {extent} mm (right, anterior, superior)")


def _is_confirmed(extent: str) -> bool:
    """Ask whether a body of this extent is meant; no answer is a no."""
    try:
        return click.confirm(f"The body measures {extent} mm (right, anterior, superior). Write it anyway?", err=True)
    except click.Abort:
        return False
