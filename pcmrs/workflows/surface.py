"""Surface of the body in a procedure: its file, and the check that it is this patient's."""

from __future__ import annotations

from pathlib import Path

import structlog

from pcmrs.errors import ConfigurationError
from pcmrs.formats.mesh import Mesh, read_mesh
from pcmrs.workflows.settings import BodySettings, ProcedureSettings

log = structlog.get_logger(__name__)

PHANTOM = "phantom"
"""Name of the patient whose surfaces are shipped."""


def read_surface(settings: ProcedureSettings) -> Mesh | None:
    """Return the surface of the body in the image, m; None, with a warning in the log, if none is configured.

    Raises:
        ConfigurationError: There is no such file, or it is the phantom's while the patient is not.
        FileFormatError: The file is not a mesh.
    """
    body = settings.body
    if not body.surface:
        log.warning("no_body_surface", text="procedure.body.surface is empty: the arm does not keep away from the body")
        return None
    file = find_surface(body)
    if file.parent in _shipped() and settings.patient != PHANTOM:
        text = (
            f"procedure.body.surface is {body.surface}, a phantom's, but the patient is {settings.patient}: set it to "
            "the patient's own surface, or to nothing to go without."
        )
        raise ConfigurationError(text, surface=body.surface, patient=settings.patient)
    return read_mesh(file, body.unit, body.space)


def find_surface(body: BodySettings) -> Path:
    """Return the path of the surface's file.

    Raises:
        ConfigurationError: There is no such file.
    """
    name = Path(body.surface).expanduser()
    folders = [Path(folder).expanduser() for folder in body.folders] + _shipped()
    places = [name] if name.name != body.surface else [folder / name for folder in folders]
    found = next((place for place in places if place.is_file()), None)
    if found is None:
        text = f"procedure.body.surface: there is no {', no '.join(map(str, places))}."
        raise ConfigurationError(text, surface=body.surface)
    return found.resolve()


def _shipped() -> list[Path]:
    """Return the folders of the examples: in the installed package, and beside it."""
    package = Path(__file__).resolve().parents[1]
    return [package / "examples", package.parent / "examples"]
