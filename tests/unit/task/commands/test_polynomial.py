"""Tracks of minimum snap: against scipy's splines of degree 7, the closed form of one segment, and the limits."""

import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline, make_interp_spline

from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import Task
from aerial_gym.task.commands.polynomial import control_point_weights, derivative_weights, minimum_snap_weights
from tests.unit.task.hover import make

LIMITS = {"max_speed": 8.0, "max_acceleration": 30.0}
AT_REST = [(1, np.zeros(3)), (2, np.zeros(3)), (3, np.zeros(3))]


def fit_spline(points: np.ndarray, times: np.ndarray) -> BSpline:
    """Return the spline of degree 7 through points (K, 3) that begins and ends at rest. By the theorem of Holladay and
    de Boor it has the least snap of all curves that do."""
    return make_interp_spline(times, points, k=7, bc_type=(AT_REST, AT_REST))


def tracks(num_envs: int = 5, points: int = 5, *, seed: int = 0) -> Task:
    params = {"points": points, "size": [1.5, 1.0, 0.5], "center": [0.0, 1.0, 2.0], **LIMITS}
    task = make(num_envs, command=CommandCfg(generator="polynomial", params=params), seed=seed)
    task.reset()
    return task


def read_draws(task: Task) -> tuple[np.ndarray, np.ndarray]:
    own = task.values.own
    return own["track_points"].double().view(task.num_envs, 3, -1).mT.numpy(), own["track_time"].double().numpy()


def test_two_points_are_joined_by_the_polynomial_of_rest_to_rest() -> None:
    """35 u^4 - 84 u^5 + 70 u^6 - 20 u^7: zero velocity, acceleration and jerk at both ends."""
    ((_, weights),) = minimum_snap_weights(2).transpose(0, 2, 1)
    np.testing.assert_allclose(weights, [0, 0, 0, 0, 35, -84, 70, -20], atol=1e-10)


@pytest.mark.parametrize("points", [3, 5, 10])
def test_pieces_meet_with_six_derivatives_and_sum_to_one(points: int) -> None:
    """Weights of all points sum to 1, so that a track moves with its points; steps at knots are round-off of 7! terms."""
    form = minimum_snap_weights(points)
    np.testing.assert_allclose(form.sum(-1), [[1.0] + [0.0] * 7] * (points - 1), atol=1e-9)
    for _ in range(7):
        np.testing.assert_allclose(form.sum(1)[:-1], form[1:, 0], atol=1e-9 * np.abs(form).max())
        form = derivative_weights(form)


def test_bernstein_control_points_are_those_of_a_known_polynomial() -> None:
    """u² has 0, 0, 1 and 2 u has 0, 2; a value lies between the least and the largest of them."""
    square = np.array([0.0, 0.0, 1.0]).reshape(1, 3, 1)
    assert control_point_weights(square).ravel().tolist() == [0.0, 0.0, 1.0]
    assert control_point_weights(derivative_weights(square)).ravel().tolist() == [0.0, 2.0]


@pytest.mark.parametrize("points", [pytest.param(2, marks=pytest.mark.slow), 5])
def test_a_target_flies_the_spline_of_its_points(points: int) -> None:
    """Place, velocity and acceleration are scipy's, and so each is the derivative of the one before; at the end it
    stays. Bounds: 200 roundings of float32 of numbers of the size of the largest one."""
    task = tracks(points=points)
    knots, times = read_draws(task)
    names = ("target_position", "target_velocity", "target_acceleration")
    splines = [fit_spline(p, t * np.arange(points)) for p, t in zip(knots, times, strict=True)]
    for step in range(300):
        if step:
            task.step(torch.zeros(5, 4))
        assert (task.env.gtd["sim_steps"] == step).all()
        for order, name in enumerate(names):
            ends = (points - 1) * times
            expected = np.stack([s(min(0.01 * step, e), nu=order) for s, e in zip(splines, ends, strict=True)])
            scale = max(1.0, LIMITS["max_speed"], LIMITS["max_acceleration"]) if order else 3.0
            np.testing.assert_allclose(task.values.own[name].numpy(), expected, atol=200 * 6e-8 * scale, rtol=0)


def test_no_target_exceeds_a_limit_and_a_control_point_is_at_one() -> None:
    """Of 300 tracks, in float64: within both limits, and one of the control points is as far out as a limit allows."""
    knots, times = read_draws(tracks(300, seed=4))
    forms = (
        derivative_weights(minimum_snap_weights(5)),
        derivative_weights(derivative_weights(minimum_snap_weights(5))),
    )
    for p, t in zip(knots, times, strict=True):
        spline, at = fit_spline(p, t * np.arange(5)), np.linspace(0.0, 4.0 * t, 2001)
        shares = []
        for order, (form, limit) in enumerate(zip(forms, LIMITS.values(), strict=True), start=1):
            assert np.linalg.norm(spline(at, nu=order), axis=-1).max() <= limit * (1.0 + 1e-5)
            shares.append(np.linalg.norm(control_point_weights(form) @ p, axis=-1).max() / t**order / limit)
        assert max(shares) == pytest.approx(1.0, rel=1e-5)


def test_points_are_drawn_in_the_box_by_mask_and_by_environment() -> None:
    task = tracks(400)
    knots, times = read_draws(task)
    low, high = np.array([-1.5, 0.0, 1.5]), np.array([1.5, 2.0, 2.5])
    assert (knots >= low - 1e-6).all()
    assert (knots <= high + 1e-6).all()
    assert (knots.min((0, 1)) < low + 0.05).all()
    assert (knots.max((0, 1)) > high - 0.05).all()
    few = read_draws(tracks(3))
    assert np.array_equal(few[0], knots[:3])
    assert np.array_equal(few[1], times[:3])
    mask = torch.arange(400) % 2 == 0
    task._start_episodes(mask)
    again, later = read_draws(task)
    assert np.array_equal(again[~mask], knots[~mask])
    assert np.array_equal(later[~mask], times[~mask])
    assert (again[mask] != knots[mask]).all()


@pytest.mark.parametrize(("changes", "message"), [
    ({"points": 1}, "points = 1: must be 2 to 10"),
    ({"max_speed": 0.0}, "max_speed = 0.0: must be > 0 and finite"),
    ({"max_acceleration": float("nan")}, "max_acceleration = nan"),
    ({"size": [0.0, 0.0, 0.0]}, "and not all 0"),
])  # fmt: skip
def test_tracks_that_cannot_be_are_refused(changes: dict[str, object], message: str) -> None:
    params = {"size": [1.0, 1.0, 1.0], **LIMITS, **changes}
    with pytest.raises(ConfigError, match=f"command polynomial: .*{message}"):
        make(1, command=CommandCfg(generator="polynomial", params=params))
