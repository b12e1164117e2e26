"""Clearance between the samples of a motion, and its first violation."""

from __future__ import annotations

import numpy as np

from pcmrs.kinematics.sampled_clearance import BOUND, sample_clearance
from pcmrs.kinematics.zones import SIGHT_OF_TOOL
from pcmrs.spatial import Floats, Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.zone_cell import ARM, FACTS, FLANGE_FROM_TOOL, zone_model

TOOL_REACH = 0.2


def random_way(seed: int, samples: int = 40) -> Floats:
    """Joint positions along a bent way of some 40 cm."""
    rng = np.random.default_rng(seed)
    start, turns = rng.uniform(0.6 * ARM.lower, 0.6 * ARM.upper), rng.uniform(-0.5, 0.5, (2, 7))
    parts = np.linspace(0.0, 1.0, samples)[:, None]
    return np.asarray(start + parts * turns[0] + parts**2 * turns[1])


@run_counts(20, nightly=60)
def test_distance_between_samples_falls_at_most_by_the_bound(runs: int) -> None:
    for seed in range(runs):
        model, way = zone_model(), random_way(seed)
        rng = np.random.default_rng(seed)
        model.place("body", Transform(np.eye(3), rng.uniform((0.2, -0.4, 0.0), (0.7, 0.4, 0.6))))
        model.place("table", Transform(np.eye(3), np.array((0.0, 0.0, -0.2))))
        model.set_sight_lines((1.3, -0.5, 0.6), (0.5, 0.0, 0.1))
        least = sample_clearance(model, FACTS, TOOL_REACH, way).distances.min(axis=0)
        finer = np.linspace(0.0, len(way) - 1.0, 10 * len(way) * 10)
        between = np.column_stack([np.interp(finer, np.arange(len(way)), joint) for joint in way.T])
        finest = np.array([model.distances(q) for q in between[::7]]).min(axis=0)
        # The line of sight to the tool moves as well, as far as the tool does at most.
        bounds = np.where(model.pairs_of_zone(SIGHT_OF_TOOL), 2.0 * BOUND, BOUND)
        assert np.all(finest >= least - bounds)


@run_counts(20, nightly=60)
def test_accepted_path_holds_at_ten_times_finer_samples(runs: int) -> None:
    for seed in range(runs):
        model, way = zone_model(), random_way(seed)
        rng = np.random.default_rng(seed)
        model.place("body", Transform(np.eye(3), rng.uniform((0.2, -0.4, 0.0), (0.7, 0.4, 0.6))))
        passage = sample_clearance(model, FACTS, TOOL_REACH, way)
        violation = passage.first_violation(model, model.limits)
        parts = np.linspace(0.0, len(way) - 1.0, 10 * len(passage.postures))
        finer = np.column_stack([np.interp(parts, np.arange(len(way)), joint) for joint in way.T])
        spare = np.array([model.distances(q) for q in finer]).min(axis=0) - model.limits
        if violation is None:
            assert spare.min() >= -BOUND
        else:
            assert spare.min() < 1e-4
            assert violation.clearance.distance < violation.clearance.limit
            assert model.distances(violation.posture).min() <= violation.clearance.distance + 1e-9


def test_limits_may_differ_from_look_to_look() -> None:
    model = zone_model()
    way = np.array(FACTS.home) + np.linspace(0.0, 1.0, 60)[:, None] * np.eye(7)[0]
    model.place("body", ARM.forward(way[-1]) @ FLANGE_FROM_TOOL)
    passage = sample_clearance(model, FACTS, TOOL_REACH, way)
    pair = model.pairs.index(("tool", "body"))
    limits = np.full(passage.distances.shape, -np.inf)
    limits[: len(limits) // 3, pair] = 0.05
    assert passage.distances[: len(limits) // 3, pair].min() > 0.05
    assert passage.distances[-1, pair] < 0.0
    assert passage.first_violation(model, limits) is None, "so near it comes only where it may"
    limits[-3:, pair] = 0.02
    violation = passage.first_violation(model, limits)
    assert violation is not None
    assert (violation.clearance.link, violation.clearance.zone, violation.clearance.limit) == ("tool", "body", 0.02)
    np.testing.assert_array_equal(violation.posture, passage.postures[-3])


def test_a_retreat_may_begin_too_near_but_only_leads_out() -> None:
    model = zone_model()
    turns = np.linspace(0.0, 1.0, 60)
    out = np.array(FACTS.home) + turns[:, None] * np.eye(7)[0]
    model.place("body", ARM.forward(out[0]) @ Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    limits = np.where([zone == "body" for _, zone in model.pairs], model.limits, -np.inf)
    leaving, coming = (
        sample_clearance(model, FACTS, TOOL_REACH, out),
        sample_clearance(model, FACTS, TOOL_REACH, out[::-1]),
    )
    assert leaving.first_violation(model, limits) is not None
    assert leaving.first_approach(model, limits) is None
    back = coming.first_approach(model, limits)
    assert back is not None
    assert back.clearance.zone == "body"
    assert back.clearance.distance < back.clearance.limit
