"""What comes out of the step tables in `examples` runs on the simulated cell."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.authoring.design import design
from pcmrs.workflows.opening import open_workflow
from tests import ROOT
from tests.unit.workflows.workflow_bench import LANDMARKS, POSES, open_bench

EXAMPLES = ROOT / "examples"


def designed(name: str, folder: Path) -> Path:
    """The blueprint of a step table, as a file."""
    path = folder / f"{name}.toml"
    path.write_text(design((EXAMPLES / f"{name}.toml").read_bytes()).text)
    return path


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*_steps.toml")), ids=lambda path: path.stem)
def test_a_daemon_takes_the_designed_blueprints(path: Path, tmp_path: Path) -> None:
    assert open_workflow(str(designed(path.stem, tmp_path))).blueprint.id == path.stem


async def test_the_designed_ratms_runs(tmp_path: Path) -> None:
    async with open_bench(workflow=str(designed("ratms_steps", tmp_path))) as bench:
        await bench.refuse("digitization.digitize_all", "parent_refuses")
        await bench.refuse("registration.register", "invalid_in_state")
        await bench.accept("registration.plan_landmarks", landmarks=LANDMARKS)
        for index in range(len(LANDMARKS)):
            await bench.accept("digitization.digitize_one", index=index)
        await bench.accept("toolplan.plan", **POSES[0])
        await bench.accept("registration.register")
        assert bench.states == {"registration": "111", "digitization": "1", "toolplan": "1"}
        await bench.accept("digitization.redigitize_one", index=1)
        assert bench.states == {"registration": "100", "digitization": "0", "toolplan": "1"}
