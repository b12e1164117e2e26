"""The verdict: rates over many simulated digitizations, and what each refusal says."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError, DegeneratePointsError, GeometryError
from pcmrs.registration import (
    RegistrationGate,
    RegistrationLimits,
    RegistrationVerdict,
    judge,
    predict_tre,
    register_points,
)
from pcmrs.spatial import Floats
from tests.support.trials import examples, run_counts
from tests.unit.registration.landmark_layouts import (
    FEMUR,
    FEMUR_NAMES,
    FEMUR_SIGMA,
    HEAD,
    HEAD_NAMES,
    HEAD_SIGMA,
    VERTEX,
    any_motion,
    off_by_10_mm,
    touched,
)

GATES = ["wrong_unit", "mirrored", "swapped_landmarks", "landmark_outlier", "residual_too_large", "tre_too_large"]


@dataclass(frozen=True, eq=False)
class Case:
    """A workflow's landmarks and limits."""

    planned: Floats
    names: tuple[str, ...]
    limits: RegistrationLimits
    target: Floats

    def touch(self, rng: np.random.Generator) -> Floats:
        return touched(rng, self.planned, self.limits.sigma)

    def judge(self, digitized: Floats) -> RegistrationVerdict:
        return judge(self.planned, digitized, self.limits, names=self.names, target=self.target)


CASES = {
    "head": Case(HEAD, HEAD_NAMES, RegistrationLimits(0.0040, HEAD_SIGMA, 0.0040), VERTEX),
    "femur": Case(FEMUR, FEMUR_NAMES, RegistrationLimits(0.0027, FEMUR_SIGMA, 0.0030), np.array([0.12, 0.01, -0.025])),
}
OFFSETS = [(0, (0.025, 0.0, 0.0)), (1, (0.0, 0.020, 0.0)), (2, (0.0, 0.0, -0.023))]
"""The published large digitization errors."""


def refused(verdict: RegistrationVerdict) -> RegistrationGate:
    assert verdict.refusal is not None
    return verdict.refusal


def off_by(rng: np.random.Generator, case: Case, index: int, offset: np.ndarray) -> Floats:
    planned = case.planned + rng.normal(scale=case.limits.sigma, size=case.planned.shape)
    planned[index] += offset
    moved: Floats = any_motion(rng) @ planned
    return moved


@run_counts(200, nightly=1000)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_good_sets_are_accepted(case: Case, runs: int) -> None:
    rng = np.random.default_rng(1)
    refusals = Counter(
        gate.name for _ in range(runs) for gate in case.judge(case.touch(rng)).gates if not gate.accepted
    )
    # The mean-shift test alone refuses some, at most as many as it was told: 1 % and three deviations.
    assert refusals["landmark_outlier"] < 0.01 * runs + 3.0 * np.sqrt(0.01 * runs)
    assert refusals["residual_too_large"] < 0.005 * runs
    assert refusals.keys() <= {"landmark_outlier", "residual_too_large"}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_accepted_set_passes_every_gate_and_predicts_its_error(case: Case) -> None:
    digitized = case.touch(np.random.default_rng(2))
    verdict = case.judge(digitized)
    assert verdict.accepted
    assert (verdict.refusal, verdict.suspect, verdict.permutation) == (None, None, None)
    assert [gate.name for gate in verdict.gates] == GATES
    assert all(gate.value <= gate.limit for gate in verdict.gates)
    assert verdict.registration is not None
    expected = register_points(digitized, case.planned).fixed_from_moving
    np.testing.assert_array_equal(verdict.registration.fixed_from_moving.matrix, expected.matrix)
    assert verdict.tre == pytest.approx(predict_tre(case.planned, case.target, case.limits.sigma)[0])


@run_counts(40, nightly=200)
@pytest.mark.parametrize(("index", "offset"), OFFSETS)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_published_errors_are_refused_and_the_landmark_is_named(
    case: Case, index: int, offset: tuple[float, float, float], runs: int
) -> None:
    rng = np.random.default_rng(3)
    named = mentioned = 0
    for _ in range(runs):
        verdict = case.judge(off_by(rng, case, index, np.array(offset)))
        gate = refused(verdict)
        assert gate.name == "landmark_outlier"
        assert verdict.registration is not None
        assert verdict.registration.residual > case.limits.residual  # a fixed limit alone finds these, too
        named += verdict.suspect == index
        assert verdict.suspect is not None
        assert f"Digitize {case.names[verdict.suspect]} again" in gate.text
        mentioned += case.names[index] in gate.text.partition("Digitize")[2]
    # With six landmarks always the right one; with four, the others can be checked by three distances only.
    assert named >= (runs if len(case.planned) == 6 else 0.85 * runs)
    assert mentioned >= 0.99 * runs


@run_counts(60, nightly=300)
def test_landmark_off_by_10_mm_is_named_where_residual_misses_it(runs: int) -> None:
    case = CASES["head"]
    digitized, index = off_by_10_mm(np.random.default_rng(4), runs)
    verdicts = [case.judge(each) for each in digitized]
    found = sum(verdict.suspect is not None for verdict in verdicts)
    named = sum(verdict.suspect == off for verdict, off in zip(verdicts, index, strict=True))
    assert found >= 0.75 * runs - 3.0 * np.sqrt(0.75 * 0.25 * runs)  # 75 % less three deviations
    assert named >= 0.95 * found
    assert sum(not refuses_residual(verdict) for verdict in verdicts) >= 0.60 * runs


def refuses_residual(verdict: RegistrationVerdict) -> bool:
    return any(gate.name == "residual_too_large" and not gate.accepted for gate in verdict.gates)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_two_landmarks_touched_in_the_wrong_order_are_named(case: Case) -> None:
    rng = np.random.default_rng(5)
    count, told = len(case.planned), 0
    for _ in range(100):
        a, b = sorted(rng.choice(count, 2, replace=False).tolist())
        order = np.arange(count)
        order[[a, b]] = b, a
        verdict = case.judge(case.touch(rng)[order])
        gate = refused(verdict)
        if gate.name == "swapped_landmarks":
            told += 1
            assert verdict.permutation == tuple(order.tolist())
            assert f"{case.names[a]} and {case.names[b]} are exchanged" in gate.text
            assert (verdict.suspect, verdict.tre) == (None, None)
    assert told >= 95  # the rest is refused as well, for what noise adds to it


def test_ring_of_three_is_named_and_nine_are_tried_in_pairs() -> None:
    case, rng = CASES["head"], np.random.default_rng(6)
    ring = (0, 4, 2, 3, 5, 1)
    verdict = case.judge(case.touch(rng)[list(ring)])
    assert verdict.permutation == ring
    assert "nose_tip, left_tragus and right_tragus are exchanged" in refused(verdict).text

    nine = np.concatenate((HEAD, [(0.0, -0.1, 0.05), (-0.07, -0.06, 0.03), (0.02, 0.05, 0.12)]))
    order = [0, 1, 2, 3, 4, 8, 6, 7, 5]
    digitized = touched(rng, nine, HEAD_SIGMA)[order]
    verdict = judge(nine, digitized, case.limits, names="abcdefghi", target=None)
    assert verdict.permutation == tuple(order)
    assert "f and i are exchanged" in refused(verdict).text


@pytest.mark.parametrize(
    ("planned_unit", "digitized_unit", "said"),
    [(1.0, 1000.0, "digitized ones look like mm"), (1000.0, 1.0, "planned ones look like mm"), (1.0, 39.37, "in m")],
)
def test_a_wrong_unit_is_named(planned_unit: float, digitized_unit: float, said: str) -> None:
    case, rng = CASES["head"], np.random.default_rng(7)
    digitized = digitized_unit * case.touch(rng)
    verdict = judge(planned_unit * HEAD, digitized, case.limits, names=case.names, target=None)
    gate = refused(verdict)
    assert gate.name == "wrong_unit"
    assert said in gate.text
    assert gate.value == pytest.approx(max(digitized_unit, planned_unit), rel=0.1)
    assert gate.value > gate.limit
    assert verdict.registration is None


def test_landmarks_at_one_place_are_no_mere_unit_error() -> None:
    case, place = CASES["head"], np.tile((0.1, 0.2, 0.3), (6, 1))
    with pytest.raises(DegeneratePointsError, match="coincide"):
        case.judge(place)
    gate = refused(case.judge(place + np.random.default_rng(15).normal(scale=1e-4, size=(6, 3))))
    assert gate.name == "wrong_unit"
    assert "all were digitized at one place" in gate.text


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_a_flipped_image_is_named(case: Case) -> None:
    rng = np.random.default_rng(8)
    flipped = replace(case, planned=case.planned * (-1.0, 1.0, 1.0))
    for _ in range(100):
        verdict = flipped.judge(case.touch(rng))
        gate = refused(verdict)
        assert gate.name == "mirrored"
        assert gate.value > gate.limit
        assert "LAS" in gate.text
        assert verdict.registration is None


def test_exchange_of_all_left_and_right_is_a_mirror_image() -> None:
    """A head is as good as symmetric: nothing tells a flipped image from exchanged sides, and the text says both."""
    gate = refused(CASES["head"].judge(CASES["head"].touch(np.random.default_rng(14))[[0, 1, 3, 2, 5, 4]]))
    assert gate.name == "mirrored"
    assert "left and right points are exchanged" in gate.text


def test_target_far_from_the_landmarks_is_refused() -> None:
    """If the target is unknown, the prediction is for the centroid, and the text says so."""
    case, digitized = CASES["head"], CASES["head"].touch(np.random.default_rng(9))
    far = replace(case, target=np.array([0.0, -0.25, 0.25])).judge(digitized)
    gate = refused(far)
    assert (gate.name, gate.value) == ("tre_too_large", far.tre)
    assert "around the target" in gate.text
    near = judge(case.planned, digitized, case.limits, names=case.names, target=None)
    assert near.accepted
    assert near.tre == pytest.approx(predict_tre(HEAD, HEAD.mean(axis=0), HEAD_SIGMA)[0])
    assert "centroid" in near.gates[-1].text


def test_much_noise_without_one_culprit_is_a_residual() -> None:
    case, rng = CASES["head"], np.random.default_rng(10)
    lenient = replace(case, limits=replace(case.limits, sigma=0.005, tre=0.05))
    digitized = touched(rng, HEAD, 0.005)
    gate = refused(lenient.judge(digitized))
    assert gate.name == "residual_too_large"
    assert "4.00 mm" in gate.text
    assert "largest deviation is at" in gate.text


def test_three_landmarks_cannot_name_a_wrong_one() -> None:
    case = CASES["head"]
    rows = [0, 4, 5]
    digitized = case.touch(np.random.default_rng(11))[rows]
    verdict = judge(HEAD[rows], digitized, case.limits, names=[HEAD_NAMES[row] for row in rows], target=None)
    assert verdict.accepted
    assert "Not tested" in verdict.gates[GATES.index("landmark_outlier")].text


def test_covariances_decide_what_is_an_outlier() -> None:
    """12 mm along an axis that is known to be noisy is nothing; across it, a wrong landmark."""
    case, rng = CASES["head"], np.random.default_rng(12)
    body_ref_from_image = any_motion(rng)
    along = body_ref_from_image.rotation @ np.diag((0.001, 0.001, 0.006)) @ body_ref_from_image.rotation.T
    covariances = np.tile(along @ along, (6, 1, 1))
    verdicts = []
    for offset in ((0.0, 0.0, 0.012), (0.012, 0.0, 0.0)):
        planned = HEAD.copy()
        planned[4] += offset
        verdicts.append(
            judge(
                HEAD,
                body_ref_from_image @ planned,
                replace(case.limits, tre=0.1),
                names=HEAD_NAMES,
                target=VERTEX,
                covariances=covariances,
            )
        )
    assert verdicts[0].suspect is None
    assert verdicts[1].suspect == 4
    assert refused(verdicts[1]).name == "landmark_outlier"


@run_counts(50, nightly=200)
def test_false_alarms_with_covariances_are_as_rare_as_stated(runs: int) -> None:
    case, rng = CASES["femur"], np.random.default_rng(13)
    root = np.diag((0.0005, 0.0005, 0.0015)) @ any_motion(rng).rotation
    covariances = np.tile(root @ root.T, (4, 1, 1))
    alarms = 0
    for _ in range(runs):
        digitized = FEMUR + rng.normal(size=FEMUR.shape) @ root.T
        verdict = judge(
            FEMUR, digitized, replace(case.limits, tre=0.1), names=FEMUR_NAMES, target=None, covariances=covariances
        )
        alarms += verdict.suspect is not None
    # 1 % of 200 is 2, and of 50 it is 0.5; more than 8 and more than 4 have a probability of 0.02 %.
    assert alarms <= (8 if runs == 200 else 4)


@examples(25)
@given(st.integers(0, 2**32 - 1))
def test_the_verdict_does_not_depend_on_the_frames(seed: int) -> None:
    case, rng = CASES["head"], np.random.default_rng(seed)
    digitized = off_by(rng, case, int(rng.integers(6)), rng.normal(scale=0.006, size=3))
    here, there = case.judge(digitized), case.judge(any_motion(rng) @ digitized)
    assert [gate.accepted for gate in here.gates] == [gate.accepted for gate in there.gates]
    assert here.suspect == there.suspect
    assert [gate.value for gate in here.gates] == pytest.approx([gate.value for gate in there.gates], rel=1e-6)


def test_invalid_landmark_sets_raise() -> None:
    case = CASES["head"]
    with pytest.raises(GeometryError, match="5 moving"):
        judge(HEAD[:5], HEAD, case.limits, names=HEAD_NAMES, target=None)
    with pytest.raises(GeometryError, match="names"):
        judge(HEAD, HEAD, case.limits, names=HEAD_NAMES[:3], target=None)
    with pytest.raises(DegeneratePointsError):
        judge(HEAD[:2], HEAD[:2], case.limits, names=HEAD_NAMES[:2], target=None)
    for target in ((0.0, 0.0), np.zeros((2, 3)), (0.0, np.nan, 0.0)):
        with pytest.raises(GeometryError, match="target"):
            judge(HEAD, HEAD, case.limits, names=HEAD_NAMES, target=target)
    with pytest.raises(ConfigurationError, match="sigma"):
        RegistrationLimits(0.004, 0.0, 0.004)
    with pytest.raises(ConfigurationError, match="false-alarm"):
        RegistrationLimits(0.004, 0.002, 0.004, false_alarm=1.0)
