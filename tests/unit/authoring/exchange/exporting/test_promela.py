"""The verifier and SPIN come to the same verdicts, on sound workflows and on broken ones."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from random import Random

import msgspec
import pytest

from pcmrs.authoring.exchange.exporting.promela import promela
from pcmrs.fsm.blueprint import Blueprint, Condition, PropertySpec
from pcmrs.fsm.verify import Verification, verify
from tests.support.shipped import shipped_blueprint
from tests.unit.fsm.random_blueprints import random_blueprint
from tests.unit.fsm.ratms_mutants import mutants

MISSING = [program for program in ("spin", "tcc") if shutil.which(program) is None]

pytestmark = [
    pytest.mark.spin,
    pytest.mark.skipif(bool(MISSING), reason=f"{' and '.join(MISSING)} not installed: make spin"),
]


class Pan:
    """SPIN's search of a model."""

    def __init__(self, model: str, folder: Path) -> None:
        self.folder = folder
        (folder / "model.pml").write_text(model)
        self._run("spin", "-a", "model.pml")
        self._run("tcc", "-w", "-DSAFETY", "-DNOREDUCE", "-o", "pan", "pan.c")

    def joint_states(self) -> int:
        found = re.search(r"(\d+) states, stored", self._run("./pan", "-w12", "-E", "-noclaim"))
        assert found is not None
        return int(found[1])

    def holds(self, claim: str) -> bool:
        found = re.search(r"errors: (\d+)", self._run("./pan", "-w12", "-E", "-N", claim))
        assert found is not None
        return found[1] == "0"

    def _run(self, *command: str) -> str:
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, timeout=100, check=False)
        assert done.returncode == 0 or command[0] == "./pan", done.stdout + done.stderr
        return done.stdout


def promising(blueprint: Blueprint, rng: Random) -> Blueprint:
    """The workflow with one promise of each kind that SPIN can be asked for."""

    def condition() -> Condition:
        named = rng.sample(list(blueprint.branches), min(2, len(blueprint.branches)))
        states = {name: [state for state in blueprint.branches[name].states if rng.random() < 0.6] for name in named}
        operations = [
            f"{name}.{operation}"
            for name, branch in blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not spec.iio
        ]
        return Condition(states=states, accepted=rng.sample(operations, 1) if rng.random() < 0.2 else [])

    promises = [
        PropertySpec(id="always", when=condition(), always=condition()),
        PropertySpec(id="never", when=condition(), never=condition()),
        PropertySpec(id="reachable", reachable=condition()),
    ]
    return msgspec.structs.replace(blueprint, properties=promises)


def random_names(seeds: range) -> list[str]:
    return [f"random {seed}" for seed in seeds]


FIRST = {" ".join(name.split()[-2:]): name for name in reversed([*mutants()])}
"""The first mutant of each kind: "without requires", "not revoked" and so on."""

QUICK = ["ratms", *FIRST.values(), *random_names(range(20))]
"""Workflows of `make test`."""

MORE = [name for name in [*mutants(), *random_names(range(20, 90))] if name not in QUICK]
"""Workflows of the nightly run."""


def made(name: str) -> Blueprint:
    if name == "ratms":
        return shipped_blueprint("ratms")
    if name in mutants():
        return mutants()[name]()
    rng = Random(int(name.removeprefix("random ")))
    return promising(random_blueprint(rng), rng)


def broken_properties(verification: Verification) -> set[str]:
    """Return the indices of properties that do not hold."""
    return {finding.path[1] for finding in verification.findings if finding.code == "property_violated"}


def test_each_kind_of_promise_is_kept_and_broken_by_random_ones() -> None:
    verdicts: set[tuple[str, bool]] = set()
    for blueprint in (made(name) for name in QUICK if name.startswith("random")):
        verification = verify(blueprint)
        found = {finding.code for finding in verification.findings}
        if not found & {"endless_cascade", "no_outcome"}:
            verdicts.add(("deadlock", "deadlock" in found))
            verdicts |= {
                (spec.id, str(number) in broken_properties(verification))
                for number, spec in enumerate(blueprint.properties)
            }
    assert verdicts == {
        (kind, broken) for kind in ("deadlock", "always", "never", "reachable") for broken in (False, True)
    }


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.nightly) for name in MORE)])
def test_spin_says_the_same(name: str, tmp_path: Path) -> None:
    blueprint = made(name)
    verification = verify(blueprint)
    found = {finding.code for finding in verification.findings}
    broken = broken_properties(verification)
    model = promela(blueprint)
    pan = Pan(model, tmp_path)
    assert pan.joint_states() == verification.joint_states
    assert pan.holds("children_fit")
    if found & {"endless_cascade", "no_outcome"}:
        return  # of a workflow so broken the verifier says nothing else
    assert pan.holds("deadlock") == ("deadlock" not in found)
    for number, spec in enumerate(blueprint.properties):
        if f"never property_{number} " in model:
            kept = str(number) not in broken
            assert pan.holds(f"property_{number}") == (kept if spec.reachable is None else not kept), spec.id


def test_properties_of_running_operations_are_not_modelled() -> None:
    model = promela(shipped_blueprint("ratms"))
    assert "property 0, approach_only_when_ready: it needs `running`" in model
    assert "never property_0" not in model
