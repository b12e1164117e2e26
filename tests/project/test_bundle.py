"""The installer in the archive for machines without a network: it installs all or nothing, and replaces nothing.

`deploy/bundle/try.sh` installs a whole archive in a root without a network, which takes minutes; it is run by hand.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT

INSTALLER = ROOT / "deploy" / "bundle" / "install.sh"
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """A bundle whose only wheel is damaged, but listed with its own hash."""
    folder = tmp_path / "pcmrs-0.1.0"
    (folder / "wheels").mkdir(parents=True)
    (folder / "pip").mkdir()
    shutil.copy(INSTALLER, folder)
    (folder / "VERSION").write_text("0.1.0\n")
    (folder / "PYTHON").write_text(f"{PYTHON}\n")
    (folder / "pip" / "pip-1-py3-none-any.whl").write_bytes(b"no archive")
    (folder / "wheels" / "pcmrs-0.1.0-py3-none-any.whl").write_bytes(b"no archive")
    (folder / "wheels.txt").write_text("")
    list_hashes(folder)
    (tmp_path / "opt").mkdir()
    return folder


def list_hashes(folder: Path) -> None:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "SHA256SUMS")
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  ./{path.relative_to(folder)}\n" for path in files]
    (folder / "SHA256SUMS").write_text("".join(lines))


def refusal(bundle: Path) -> str:
    """Run the installer, which must fail and leave nothing; return what it says."""
    place = bundle.parent / "opt"
    before = sorted(place.iterdir())
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    words = ["bash", str(bundle / "install.sh"), str(place)]
    ended = subprocess.run(words, env={"PATH": path}, capture_output=True, text=True, check=False)
    assert ended.returncode != 0
    assert sorted(place.iterdir()) == before
    return ended.stderr


def test_a_changed_file_is_found_before_anything_is_written(bundle: Path) -> None:
    (bundle / "wheels.txt").write_text("changed")
    assert "the bundle is damaged: copy it again" in refusal(bundle)


def test_a_missing_file_is_found_before_anything_is_written(bundle: Path) -> None:
    (bundle / "wheels" / "pcmrs-0.1.0-py3-none-any.whl").unlink()
    assert "the bundle is damaged" in refusal(bundle)


def test_wheels_of_another_python_are_not_tried(bundle: Path) -> None:
    (bundle / "PYTHON").write_text("3.0\n")
    list_hashes(bundle)
    said = refusal(bundle)
    assert "the wheels are for 3.0" in said or "there is no Python" in said


def test_an_installed_version_is_not_replaced(bundle: Path) -> None:
    (bundle.parent / "opt" / "pcmrs-0.1.0").mkdir()
    assert "this version is installed" in refusal(bundle)


def test_a_folder_of_an_earlier_way_to_install_is_not_replaced(bundle: Path) -> None:
    (bundle.parent / "opt" / "pcmrs").mkdir()
    assert "move it away" in refusal(bundle)


def test_an_installation_that_fails_leaves_nothing(bundle: Path) -> None:
    """Here pip itself cannot be read."""
    refusal(bundle)
