"""What is installed is what is locked, byte for byte: nothing that anybody is told to type takes another file."""

from __future__ import annotations

import hashlib
import re
import runpy
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pcmrs.extras import EXTRAS
from tests import ROOT

SOURCES = ("deploy", "docs", ".ci")
TAKES_FILES = re.compile(r"\b(pip|uv)[\w.\"]* +(pip +)?(install|wheel|download|sync)\b")
OUR_OWN = ("--no-deps --no-index", "--no-deps --no-build-isolation", "--no-index --find-links", "--require-hashes")

locked: Callable[[list[str]], str] = runpy.run_path(str(ROOT / "deploy" / "locked.py"))["locked"]


def names(text: str) -> set[str]:
    return set(re.findall(r"^([a-z0-9-]+)==", text, re.MULTILINE))


def test_every_install_names_hashes_or_takes_files_that_exist() -> None:
    files = [ROOT / "README.md", ROOT / "Makefile", ROOT / "CONTRIBUTING.md"]
    files += [path for folder in SOURCES for path in sorted((ROOT / folder).rglob("*")) if path.is_file()]
    wrong = []
    for path in files:
        if path.name == "progress.md" or path.suffix in (".svg", ".png", ".pyc") or not path.exists():
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            known = line.endswith("/pcmrs-*.whl") or "--no-deps ." in line or any(each in line for each in OUR_OWN)
            if TAKES_FILES.search(line) and not known:
                wrong.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert wrong == []


def test_extra_installs_what_it_needs_and_no_developer_tools() -> None:
    base, sim = locked([]), locked(["sim"])
    assert {"eclipse-zenoh", "msgspec", "click"} <= names(base)
    assert not names(base) & {"matplotlib", "mujoco", "pin", "plutoprint", "resvg-py", "scipy", "uvloop"}
    assert {"mujoco", "glfw"} <= names(sim)  # the latter is needed by the former only
    assert {"pin", "uvloop", "foxglove-sdk"} <= names(sim)  # by the daemon, for which it is the cell
    assert names(sim) | {"matplotlib", "plutoprint"} <= names(locked(["lab"]))
    assert {"nicegui", "starlette"} <= names(locked(["console"]))
    assert not names(locked(["sim", "hardware", "console"])) & {"pytest", "mypy", "ruff", "detect-secrets"}
    lock = (ROOT / "requirements.lock").read_text()
    for text in (base, sim):
        entries = re.split(r"^(?=[a-z])", text, flags=re.MULTILINE)[1:]
        assert all(entry in lock and "--hash=sha256:" in entry for entry in entries)


def test_extra_that_is_not_locked_is_an_error() -> None:
    with pytest.raises(SystemExit, match="no extra"):
        locked(["everything"])
    with pytest.raises(SystemExit, match="evdev"):
        locked(["teleop"])


def test_the_sbom_has_every_locked_extra() -> None:
    """It is made of what `.ci/wheel` has installed last."""
    (*_, last) = re.findall(r'^install "[^"]*" (.*)$', (ROOT / ".ci" / "wheel").read_text(), re.MULTILINE)
    assert set(last.split()) == {"lab", "sim", *EXTRAS} - {"teleop"}


def test_another_file_under_the_same_name_and_version_is_refused(tmp_path: Path) -> None:
    """As an index offers it that somebody else controls; without the hashes it is taken."""
    entry = next(each for each in re.split(r"^(?=[a-z])", locked([]), flags=re.MULTILINE) if each.startswith("click=="))
    version = entry.split()[0].removeprefix("click==")
    wheel = tmp_path / f"click-{version}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        about = f"click-{version}.dist-info"
        file.writestr("click.py", "print('not click')")
        file.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: click\nVersion: {version}\n")
        file.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nGenerator: x\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        file.writestr(f"{about}/RECORD", "")
    assert hashlib.sha256(wheel.read_bytes()).hexdigest() not in entry
    (tmp_path / "locked.txt").write_text(entry)
    (tmp_path / "ranges.txt").write_text("click>=8\n")
    ended = {}
    for name, more in (("locked", ["--require-hashes"]), ("ranges", [])):
        words = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--no-index",
            "--find-links",
            str(tmp_path),
            "--no-deps",
            *more,
        ]
        words += ["--requirement", str(tmp_path / f"{name}.txt"), "--dest", str(tmp_path / name)]
        ended[name] = subprocess.run(words, capture_output=True, text=True, check=False)
    assert ended["ranges"].returncode == 0, ended["ranges"].stderr
    assert ended["locked"].returncode != 0
    assert "HASH" in ended["locked"].stderr.upper()
