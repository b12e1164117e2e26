"""Writes the folder of a cell with the version of PCMRS in a checkout, as a fixture of that version.

    python -m tests.unit.maintenance.write_folder CHECKOUT NAME [LIBRARIES]

It needs an environment with the libraries of that version, of which some may be in the folder LIBRARIES, and uses its
command line, its files and its bytes on the wire only. A procedure runs on the simulated cell up to a saved placement;
the daemon ends in order. The result is ``folders/NAME.tar.gz`` beside this file.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tarfile
import tempfile
import textwrap
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

FOLDERS = Path(__file__).parent / "folders"
NAME, PEER = "cell1", "planner"
TIP = (0.0, 0.0, -0.15)
"""Tip in the pointer's marker body, m: that of the simulated pointer."""

WRITE_CALIBRATIONS = """
import datetime, sys
from pathlib import Path
from pcmrs.calibration import Calibration, write_calibration
from pcmrs.messages import PoseMessage
folder, transforms = Path(sys.argv[1]), {transforms}
for kind, name in transforms.items():
    pose = PoseMessage(position={tip}, quat_wxyz=(1.0, 0.0, 0.0, 0.0))
    write_calibration(folder / f"{{kind}}.toml", Calibration(
        kind=kind, type="" if kind == "pointer" else "coil", name=kind, serial="17", method="fixture", error_mm=0.1,
        date=datetime.datetime(2026, 11, 23, 9, tzinfo=datetime.UTC), valid_days=36500, transforms={{name: pose}},
    ))
"""


def main(checkout: Path, name: str, *libraries: Path) -> None:
    """Write the fixture `name` with the version in `checkout`, and further libraries."""
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch).resolve()
        version = Version(checkout.resolve(), work, libraries)
        folder = work / "lab"
        version.write(folder)
        FOLDERS.mkdir(exist_ok=True)
        with tarfile.open(FOLDERS / f"{name}.tar.gz", "w:gz") as archive:
            archive.add(folder, "lab", filter=_anonymous)


class Version:
    """One version of PCMRS.

    Args:
        checkout: Its checkout.
        work: Folder for what only this program needs.
        libraries: Folders with libraries that the environment lacks.
    """

    def __init__(self, checkout: Path, work: Path, libraries: Sequence[Path] = ()) -> None:
        self._checkout = checkout
        self._work = work  # Python imports from the working directory first
        self._environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [*self._paths(work), *libraries]))}

    def write(self, lab: Path) -> None:
        """Write a lab with one cell: authority, keys, calibrations, configuration, and the cell's folder."""
        lab.mkdir()
        self._pcmrs("pki", "init", "--site", "lab", "--folder", lab / "pki")
        for role, member in (("daemon", NAME), ("operator", "ann")):
            self._pcmrs(
                "pki", "issue", role, member, "--cell", f"lab/{NAME}", "--folder", lab / "pki", "-o", lab,
                "--days", "398",
            )  # fmt: skip
        self._pcmrs("peers", "new", PEER, "--folder", lab)
        self._calibrate(lab)
        (lab / "cell.toml").write_text(configuration(lab))
        port = _free_port()
        own = ["--set", f"cell.folder={lab / 'cell'}", "--set", f"cell.endpoint=tcp/127.0.0.1:{port}"]
        with self._served(lab, own) as ready:
            self._run_procedure(lab, f"tcp/127.0.0.1:{port}", ready)
        for lock in lab.rglob("*.lock"):
            lock.unlink()

    def _run_procedure(self, lab: Path, endpoint: str, ready: dict[str, Any]) -> None:
        plan = json.loads((self._checkout / "examples" / "ratms_plan.json").read_text())
        for operation, arguments in (
            ("robot.connect", {}),
            ("registration.plan_landmarks", {"landmarks": plan["landmarks"]}),
            ("digitization.digitize_all", {}),
            ("registration.register", {}),
            ("toolplan.plan", plan["poses"][0]),
            ("placement.confirm", {}),  # rejected: the tool is not at its standoff
        ):
            words = ("call", operation, json.dumps(arguments), "--endpoint", endpoint)
            self._pcmrs(*words, check=operation != "placement.confirm")
        signer = self._pcmrs_signer(lab)
        with socket.socket(type=socket.SOCK_DGRAM) as link:
            link.settimeout(20.0)
            link.connect(tuple(ready["links"]["planner"]))
            for command in (b"get_jnt_angsxxxx_#1;", b"save_planandreal_#2;"):
                link.send(signer.sign(command))
                link.recv(2048)

    def _pcmrs_signer(self, lab: Path) -> Any:
        source = (self._checkout / "clients" / "python" / "pcmrs_signer.py").read_text()
        client: dict[str, Any] = {"__name__": "pcmrs_signer"}
        exec(compile(source, "pcmrs_signer.py", "exec"), client)  # the client of that version
        return client["Signer"](PEER, client["read_key"](str(lab / f"{PEER}.key")))

    def _calibrate(self, lab: Path) -> None:
        tool = "flange_from_tool_marker"
        if tool not in (self._checkout / "pcmrs" / "calibration" / self._calibration_file()).read_text():
            tool = "flange_from_coil"
        program = WRITE_CALIBRATIONS.format(transforms={"pointer": "pointer_from_tip", "tool": tool}, tip=TIP)
        self._run(sys.executable, "-c", program, lab)

    def _calibration_file(self) -> str:
        return "file.py" if (self._checkout / "pcmrs" / "calibration" / "file.py").exists() else "_file.py"

    @contextlib.contextmanager
    def _served(self, lab: Path, own: list[str]) -> Iterator[dict[str, Any]]:
        command = [sys.executable, "-m", "pcmrs.cli", "serve", "--json", "--config", str(lab / "cell.toml"), *own]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=self._environment, cwd=lab)
        assert process.stdout is not None
        try:
            yield json.loads(process.stdout.readline())
        finally:
            process.terminate()
            process.wait(60.0)

    def _pcmrs(self, *words: object, check: bool = True) -> str:
        return self._run(sys.executable, "-m", "pcmrs.cli", *words, check=check)

    def _run(self, *words: object, check: bool = True) -> str:
        ended = subprocess.run(
            [str(word) for word in words],
            env=self._environment,
            cwd=self._work,
            capture_output=True,
            text=True,
            check=False,
        )
        if check and ended.returncode:
            raise SystemExit(f"{words}: {ended.stdout}{ended.stderr}")
        return ended.stdout

    def _paths(self, work: Path) -> list[Path]:
        """Return the folders to import from: first one that declares the entry points of this version only."""
        declared = work / "declared"
        workspace = (self._checkout / "sim" / "pyproject.toml").exists()
        points_of = {
            "pcmrs": _entry_points(self._checkout),
            "pcmrs_sim": _entry_points(self._checkout / "sim") if workspace else {},
            "pcmrs_lab": {},
        }
        for distribution, groups in points_of.items():
            folder = declared / f"{distribution}-0.1.0.dist-info"
            folder.mkdir(parents=True)
            (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 0.1.0\n")
            lines = []
            for group, points in groups.items():
                lines += [f"[{group}]", *(f"{key} = {value}" for key, value in points.items())]
            (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")
        return [declared, self._checkout, *([self._checkout / "sim"] if workspace else [])]


def _entry_points(project: Path) -> dict[str, dict[str, str]]:
    project_table = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    found: dict[str, dict[str, str]] = project_table["entry-points"]
    return found


def configuration(lab: Path) -> str:
    """Return the configuration of the cell; the calibration of the tool is left out, since later versions refuse it."""
    return textwrap.dedent(f"""\
        # Written by tests/unit/maintenance/write_folder.py.
        workflow = "ratms"

        [cell]
        site = "lab"
        name = "{NAME}"
        rate = 10

        [procedure]
        patient = "phantom"

        [procedure.calibration]
        pointer_file = "pointer.toml"

        [gateway]
        tcp_port = 0
        planner = {{ port = 0 }}
        robot = {{ port = 0 }}
        visualization = {{ port = 0 }}
        mep = {{ port = 0 }}

        [gateway.peers.{PEER}]
        key_file = "{lab}/{PEER}.key"

        [console]
        enabled = false

        [recording]
        topics = ["state/fsm", "state/event"]
        """)


def _free_port() -> int:
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port: int = link.getsockname()[1]
        return port


def _anonymous(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], *(Path(each).resolve() for each in sys.argv[3:]))
