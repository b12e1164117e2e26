"""Files for the planning: surfaces, volumes, points."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from fastapi import Response
from nicegui import app, events, ui
from nicegui.elements.upload_files import FileUpload

from pcmrs.console._geometry import as_stl
from pcmrs.console._scene import SURFACE
from pcmrs.console.planning._canvas import Canvas
from pcmrs.console.planning._forms import DraftEditor
from pcmrs.console.planning.files import LARGEST, MOST_FILES, read_points, read_surface
from pcmrs.errors import FileFormatError, PcmrsError
from pcmrs.formats.mesh import Mesh
from pcmrs.registration.triangles import TriangleSurface

ROLES = {"surface": "file_surface", "cortex": "file_cortex", "landmarks": "file_landmarks", "target": "file_target"}
"""Purposes of a file, and the key of each text."""


class UploadForm:
    """Purpose and units of an uploaded file, and the result of reading it.

    Args:
        editor: Editor of the draft.
        canvas: Scene that shows the surfaces.
    """

    def __init__(self, editor: DraftEditor, canvas: Canvas) -> None:
        self._editor, self._canvas = editor, canvas
        self._of_cell = editor.draft.surface
        self._client = ui.context.client
        texts = editor.texts
        with ui.expansion(texts("files")).classes("w-full").props('dense data-testid="files"'):
            self._role = ui.toggle({role: texts(name) for role, name in ROLES.items()}, value="surface")
            self._role.props("dense no-caps size=sm").props('data-testid="file-role"')
            with ui.row().classes("items-center gap-1"):
                self._unit = ui.select(["mm", "m"], value="mm", label=texts("unit"))
                self._space = ui.select(["RAS", "LPS"], value="RAS", label=texts("space"))
                self._threshold = ui.number(texts("threshold"), placeholder="Otsu")
            for field, name in (
                (self._unit, "unit"),
                (self._space, "space"),
                (self._threshold, "threshold"),
            ):
                field.props("dense").classes("w-28").props(f'data-testid="file-{name}"')
            ui.label(texts("file_help")).classes("text-caption text-grey-8")
            self._upload = ui.upload(
                multiple=True,
                auto_upload=True,
                max_total_size=LARGEST,
                max_files=MOST_FILES,
                on_multi_upload=self._take,
                on_rejected=lambda: self._say(texts("too_large", mb=LARGEST // 10**6, count=MOST_FILES), good=False),
            )
            self._upload.classes("w-full").props("flat bordered").props('data-testid="upload"')
            with ui.row().classes("items-center no-wrap"):
                self._busy = ui.spinner(size="sm")
                self._busy.set_visibility(False)
                self._result = ui.label().props('data-testid="upload-result"')
        with ui.row().classes("items-center no-wrap w-full bg-orange-1") as self._own:
            ui.label(texts("own_surface")).props('data-testid="own-surface"')
            back = ui.button(texts("cell_surface"), on_click=self._back).props("dense flat no-caps")
            back.props('data-testid="cell-surface"')
        self._own.set_visibility(False)

    async def _take(self, event: events.MultiUploadEventArguments) -> None:
        self._upload.reset()
        if self._busy.visible:
            self._say(self._editor.texts("file_busy"), good=False)
            return
        self._busy.set_visibility(True)
        self._say(self._editor.texts("file_read"), good=True)
        try:
            with TemporaryDirectory() as folder:  # in the folder of `pcmrs.console._uploads`
                await self._use_in(Path(folder), event.files)
        finally:
            self._busy.set_visibility(False)

    async def _use_in(self, folder: Path, files: Sequence[FileUpload]) -> None:
        """Use files by way of a folder; refusals are shown without its path."""
        try:
            await self._use(await store_upload(files, folder))
        except (PcmrsError, OSError) as error:
            text = error.text if isinstance(error, PcmrsError) else str(error)
            self._say(text.replace(f"{folder}/", "").replace(str(folder), self._editor.texts("files")), good=False)

    async def _use(self, path: Path) -> None:
        """Use a file for its purpose.

        Raises:
            PcmrsError: It cannot be used; nothing has changed.
        """
        draft, role = self._editor.draft, self._role.value
        if role in ("surface", "cortex"):
            mesh = await read_surface(path, self._unit.value, self._space.value, self._threshold.value)
            await self._use_surface(mesh, role)
        else:
            points = await read_points(path)
            if role == "landmarks":
                draft.load_landmarks(points.names, points.points)
            elif len(points.names) == 1:
                draft.aim(points.points[0])
            else:
                raise FileFormatError(f"{path} holds {len(points.names)} points; give one target.")
            self._say(", ".join(points.names), good=True)
        self._editor.changed()

    async def _use_surface(self, mesh: Mesh, role: str) -> None:
        draft = self._editor.draft
        surface, stl = await asyncio.to_thread(_prepared, mesh)
        if role == "cortex":
            draft.cortex = surface
            self._canvas.show_cortex(self._served(stl))
        else:
            draft.replace_surface(surface)
            self._canvas.show_surface(self._served(stl))
            self._canvas.look_at(mesh.vertices)
            self._own.set_visibility(True)
        x, y, z = (1000.0 * np.ptp(mesh.vertices, axis=0)).tolist()
        self._say(self._editor.texts("surface_taken", faces=len(mesh.faces), x=x, y=y, z=z), good=True)

    def _served(self, stl: bytes) -> str:
        """Return an address at which this page finds a mesh, for as long as it is open."""
        url = f"/planning/{secrets.token_urlsafe(16)}.stl"
        app.add_api_route(url, lambda: Response(stl, media_type="model/stl"), include_in_schema=False)
        self._client.on_delete(lambda: app.remove_route(url))
        return url

    def _back(self) -> None:
        self._editor.draft.replace_surface(self._of_cell)
        self._canvas.show_surface(None if self._of_cell is None else SURFACE)
        self._own.set_visibility(False)
        self._editor.changed()

    def _say(self, text: str, *, good: bool) -> None:
        self._result.set_text(text)
        self._result.classes(replace="text-grey-9" if good else "text-red-9")


async def store_upload(files: Sequence[FileUpload], folder: Path) -> Path:
    """Store the files of one upload and return their path: one file by its name, several as a folder.

    Args:
        files: The files; several are the slices of a DICOM series.
        folder: Folder to store them in.
    """
    if len(files) == 1:
        name = Path(files[0].name).name  # a browser may send a path
        path = folder / (name if name.strip(".") else "file")
        await files[0].save(path)
        return path
    for number, file in enumerate(files):
        await file.save(folder / f"{number:04d}")
    return folder


def _prepared(mesh: Mesh) -> tuple[TriangleSurface, bytes]:
    """Return the surface for nearest-point queries, and its STL for the browser.

    Raises:
        GeometryError: It is not a surface to plan on.
    """
    return TriangleSurface(mesh.vertices, mesh.faces), as_stl(mesh.vertices, mesh.faces)
