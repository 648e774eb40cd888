"""What a run knows of its parameters is what a robot file draws: deviations, limits, and what is known of two together."""

import numpy as np

from aerial_gym.robots import ROBOTS
from aerial_gym.robots.parameter_draws import correlation_factor
from aerial_gym.sim2real.judge.verdict import NamedEffect
from aerial_gym.sim2real.report.ranges import uncertainty_ranges
from tests.unit.sim2real.judge.builders import make_named_effect
from tests.unit.sim2real.set_fits import make_spread

DX, DY, WIND = "effects.rotor_drag.dx", "effects.rotor_drag.dy", "effects.constant_wind.x"


def make_effect(name: str, params: dict[str, float], std: dict[str, float], **correlation: dict) -> NamedEffect:
    return make_named_effect(name, params=params, std=std, noise_std=std, correlation=correlation)


def test_correlations_stand_beside_deviations_where_both_are_drawn() -> None:
    drag, drag_std = {"dx": 0.2, "dy": 0.1, "dz": 0.3}, {"dx": 0.02, "dy": 0.01}
    effects = (
        make_effect("rotor_drag", drag, drag_std, dy={"rotor_drag.dx": -0.8}),
        make_effect("constant_wind", {"x": 1.0}, {"x": 0.5}, x={"rotor_drag.dx": 0.5, "rotor_drag.dz": 0.1}),
    )
    ranges = uncertainty_ranges(ROBOTS.get("base_quadrotor"), effects)
    assert list(ranges) == [DX, DY, WIND]
    assert [dict(each.correlation) for each in ranges.values()] == [{}, {DX: -0.8}, {DX: 0.5}]
    names, factor = correlation_factor(ranges)
    expected = [[1.0, -0.8, 0.5], [-0.8, 1.0, 0.0], [0.5, 0.0, 1.0]]
    assert names == (DX, DY, WIND)
    np.testing.assert_allclose(factor @ factor.T, expected, atol=2e-6)


def test_the_correlation_of_a_fit_is_that_of_scatter_and_tolerances() -> None:
    """Blocks know the sum best, -3 of 4; the tolerances add 1 to each number alone: -3 of 5."""
    spread = make_spread(np.arange(2), np.eye(2), np.eye(2), blocks=[[4.0, -3.0], [-3.0, 4.0]])
    np.testing.assert_allclose(spread.correlation, [[1.0, -0.6], [-0.6, 1.0]])
