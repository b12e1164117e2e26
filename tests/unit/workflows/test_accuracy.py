"""Noise of a pointer, and the accuracy of a registration at a target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration import read_calibration
from pcmrs.errors import RefusalError
from pcmrs.registration import NoiseEstimate
from pcmrs.spatial import Transform
from pcmrs.workflows.accuracy import active_noise_sigma, check_tre, pointer_id, tre_over
from pcmrs.workflows.data import PlacementData
from tests.unit.workflows.calibration_files import write
from tests.unit.workflows.workflow_bench import WorkflowBench


@pytest.mark.parametrize(("residuals", "bound"), [(1.0, 1.5), (0.0, 0.5)])
async def test_no_noise_estimate_leaves_its_bounds(bench: WorkflowBench, residuals: float, bound: float) -> None:
    data = PlacementData(noise={pointer_id(bench.cell): NoiseEstimate(residuals, 10_000)})
    assert active_noise_sigma(bench.cell, data) == pytest.approx(bound * 0.00186)


async def test_another_pointer_begins_with_the_prior(bench: WorkflowBench) -> None:
    data = PlacementData(noise={"another": NoiseEstimate(1.0, 10_000)})
    assert active_noise_sigma(bench.cell, data) == pytest.approx(0.00186)


def test_tre_of_a_refined_registration_follows_its_covariance() -> None:
    """Oracle: samples of the small motion, applied to the targets."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * np.array([1e-3] * 3 + [5e-4] * 3)[:, None]
    covariance = root @ root.T
    body_ref_from_image = Transform.from_rotvec((0.02, 0.10, -0.05), (0.3, -0.2, 0.5))
    targets = np.array([[0.0, 0.0, 0.0], [0.08, -0.02, 0.10]])
    motions = rng.multivariate_normal(np.zeros(6), covariance, size=20_000)
    in_body_ref = body_ref_from_image @ targets
    moved = np.cross(motions[:, None, :3], in_body_ref[None]) + motions[:, None, 3:]
    sampled = np.sqrt(np.mean(np.sum(moved**2, axis=2), axis=0))
    computed = tre_over(np.zeros((0, 3)), body_ref_from_image, covariance.ravel().tolist(), 0.0, targets)
    assert computed == pytest.approx(sampled, rel=0.03)


async def test_a_far_target_is_refused_with_error_and_limit(bench: WorkflowBench) -> None:
    far = np.array((0.0, 0.6, 0.5))
    assert check_tre(bench.cell, bench.data, far) is None, "nothing is registered"
    await bench.register()
    near = check_tre(bench.cell, bench.data, np.zeros(3))
    assert near is not None
    assert near < 0.004
    with pytest.raises(RefusalError, match=r"the limit is 4\.00 mm") as refused:
        check_tre(bench.cell, bench.data, far)
    assert refused.value.refusal_code == "tre_too_large"
    assert refused.value.fields["tre"] > refused.value.fields["limit"] == pytest.approx(0.004)


async def test_error_of_the_contact_point_adds_to_the_registration(bench: WorkflowBench, tmp_path: Path) -> None:
    await bench.register()
    alone, mounting = check_tre(bench.cell, bench.data, np.zeros(3)), bench.cell.mounting
    assert alone is not None
    for tip_mm in (1.0, 5.0):
        tip = read_calibration(Path(write(tmp_path, "tip", error_mm=tip_mm)))
        bench.cell.mounting = replace(mounting, files={**mounting.files, "tip": tip})
        if tip_mm == 1.0:
            assert check_tre(bench.cell, bench.data, np.zeros(3)) == pytest.approx(np.hypot(alone, 1e-3))
    with pytest.raises(RefusalError, match=r"5\.00 mm by the tool's contact point") as refused:
        check_tre(bench.cell, bench.data, np.zeros(3))
    assert refused.value.refusal_code == "tre_too_large"
    assert refused.value.fields["tip"] == pytest.approx(5e-3)
