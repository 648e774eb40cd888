"""PX4's cascade against PX4's own control libraries: golden vectors of 10,000 random states each.

``tests/cross/firmware/px4_vectors.py`` made them; ``px4_pairs.py`` lays ours beside them.
"""

import pytest
import torch
from torch import Tensor

from aerial_gym.control.px4.attitude import wanted_rates
from aerial_gym.control.reduced_attitude import canonical, shortest_turn
from aerial_gym.math.quaternion import quat_conjugate, quat_exp, quat_from_euler, quat_multiply, quat_rotate
from tests.cross.firmware.px4_pairs import attitude_cases, attitude_pair, position_pairs, rate_pair, read_vectors

EPS = 2.0**-24
"""Half a unit in the last place of float32, in which PX4 computes."""


@pytest.fixture(scope="module")
def vectors() -> dict[str, Tensor]:
    return read_vectors()


def test_rate_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Runs of four steps, with integral, feed-forward, limits and saturated rotors."""
    ours, theirs, size = rate_pair(vectors)
    assert ours.shape == (4, 2500, 3)
    assert ((ours - theirs).abs() <= 8 * EPS * size).all()


def test_attitude_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """From any attitude to any other.

    Rounding grows where the turn is ill-conditioned: between opposite tilts by the length n of half the turn between them, and
    where the heading error w, z nears 0 or 180 degrees, as PX4 takes arc cosine and arc sine, which lose digits there.
    """
    attitude, wanted, _, gain, weight, _ = attitude_cases()
    ours, theirs = attitude_pair(vectors)
    up, goal = (quat_rotate(q, q.new_tensor((0.0, 0.0, 1.0)).expand(len(q), 3)) for q in (attitude, wanted))
    turn, _ = shortest_turn(up, goal)
    heading = canonical(quat_multiply(quat_conjugate(quat_multiply(turn, attitude)), wanted)).abs()
    n = (2.0 + 2.0 * (up * goal).sum(-1)).sqrt()
    growth = 1.0 / n + 1.0 / heading[:, 3] + 1.0 / heading[:, 2]
    bound = 8 * EPS * gain.amax(-1) / weight[:, 0] * growth
    error = (ours - theirs).abs().amax(-1)
    assert len(error) == 10_000
    assert (error <= bound).all()
    assert float(error.median()) < 2e-6


def test_position_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Runs of four steps, to positions or velocities, against all limits: acceleration, thrust and attitude."""
    pairs = position_pairs(vectors)
    for name, (ours, theirs, size) in pairs.items():
        assert ours.shape[:2] == (4, 2500)
        assert ((ours - theirs).abs() <= 64 * EPS * size).all(), name
    thrust = pairs["normalised thrust"][1].norm(dim=-1)
    assert int((thrust >= 0.6).sum()) > 1000  # so many are near the limits, 0.6 to 1, or the test would not see them


def test_a_heading_error_is_turned_to_at_its_own_gain() -> None:
    """PX4's unit test YawWeightScaling: 0.1 rad of yaw, gain 2.8, weight 0.4 give 0.28 rad/s, and no roll or pitch."""
    level, turned_by = quat_from_euler(torch.zeros(1, 3)), quat_from_euler(torch.tensor([[0.0, 0.0, 0.1]]))
    gain, limit = torch.tensor([[6.5, 6.5, 2.8]]), torch.full((1, 3), 1000.0)
    rates = wanted_rates(level, turned_by, torch.zeros(1), gain=gain, yaw_weight=torch.tensor([[0.4]]), limit=limit)
    torch.testing.assert_close(rates, torch.tensor([[0.0, 0.0, 0.28]]), atol=1e-4, rtol=0)


def test_attitude_control_converges_from_everywhere() -> None:
    """PX4's unit test AttitudeControlConvergence: eight attitudes, each to each, with the sign of the quaternion changing."""
    goals = torch.tensor(
        [
            [0, 0, 0, 1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.024, -0.681, -0.220, 0.698],
            [-0.313, 0.225, -0.423, -0.820], [-0.172, 0.755, -0.204, 0.599], [-0.662, 0.290, -0.656, 0.216],
        ], dtype=torch.float64,
    )  # fmt: skip
    goals = goals / goals.norm(dim=-1, keepdim=True)
    attitude, goal = (x.reshape(64, 4) for x in torch.broadcast_tensors(goals.unsqueeze(1), goals.unsqueeze(0)))
    gain, weight = attitude.new_tensor((0.5, 0.6, 0.3)).expand(64, 3), attitude.new_full((64, 1), 0.4)
    limit, still = attitude.new_full((64, 3), 100.0), attitude.new_zeros(64)
    before = attitude.new_full((64,), 1000.0)
    for _ in range(100):
        rates = wanted_rates(attitude, goal, still, gain=gain, yaw_weight=weight, limit=limit)
        size = rates.norm(dim=-1)
        assert ((size < before) | (size < 1e-12)).all()
        attitude, before = -quat_multiply(attitude, quat_exp(rates)), size
    assert ((attitude * goal).sum(-1).abs() > 1.0 - 1e-12).all()
