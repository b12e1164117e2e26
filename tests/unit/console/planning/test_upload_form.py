"""An uploaded file is stored in the folder for it, whatever its name says."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from nicegui.elements.upload_files import SmallFileUpload

from pcmrs.console.planning._upload_form import store_upload


@pytest.mark.parametrize("name", ["../evil.stl", "/tmp/evil.stl", "a/../../evil.nii.gz", "..", ".", ""])
def test_a_file_stays_in_the_folder_it_is_put_into(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    path = asyncio.run(store_upload([SmallFileUpload(name, "", b"evil")], folder))
    assert path.read_bytes() == b"evil"
    assert {*tmp_path.rglob("*")} == {folder, path}
    assert path.parent == folder
