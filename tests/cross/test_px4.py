"""PX4's cascade against PX4's own control libraries: golden vectors of 10,000 random states each.

``tests/cross/firmware/px4_vectors.py`` made them; ``px4_pairs.py`` lays ours beside them.
"""

from math import pi, sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym.control.px4.attitude import attitude_from_thrust, wanted_rates
from aerial_gym.control.px4.position import PositionGains, limited_velocity, thrust_of, velocity_control
from aerial_gym.control.px4.rates import grown_integral, rate_torque
from aerial_gym.control.reduced_attitude import canonical, shortest_turn
from aerial_gym.math.quaternion import (
    euler_from_quat,
    quat_conjugate,
    quat_exp,
    quat_from_euler,
    quat_multiply,
    quat_rotate,
)
from tests.cross.firmware.px4_pairs import (
    attitude_cases,
    attitude_pair,
    mixer_pair,
    position_pairs,
    rate_pair,
    read_vectors,
)

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


def test_the_mixer_is_px4s() -> None:
    """All three airmodes, quadrotors and six motors with random parts; four in five commands are beyond the limits.

    A step along a column is a quotient by a part of at least 0.2, and there are at most six: 8 roundings of numbers up to 5.
    """
    ours, theirs = mixer_pair()
    assert ours.shape == (10_000, 6)
    assert float((ours - theirs).abs().max()) <= 8 * EPS * 5.0


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


def test_nothing_wanted_and_nothing_measured_is_no_torque() -> None:
    """PX4's unit test AllZeroCase."""
    none = torch.zeros(1, 3)
    assert not rate_torque(none, none, none, none, (torch.ones(1, 3),) * 3).any()


@pytest.mark.parametrize("error", [1.0, -1.0])
def test_the_integral_of_rates_ends_at_its_limit(error: float) -> None:
    """PX4's unit test of the full limit: gain 1, 0.01 s, a rate error of 1 rad/s on roll for 1000 runs, limit 0.3."""
    integral, one = torch.zeros(1, 3, dtype=torch.float64), torch.ones(1, 3, dtype=torch.float64)
    for _ in range(1000):
        integral = grown_integral(
            integral, error * one * one.new_tensor([1.0, 0.0, 0.0]), 0.0 * one, one, 0.3 * one, 0.01
        )
    torch.testing.assert_close(integral, 0.3 * error * one.new_tensor([[1.0, 0.0, 0.0]]), rtol=0, atol=1e-12)


def of_tests(**changes: float) -> PositionGains:
    """Return the gains with which PX4 tests its position control: P 1, PID of velocity 20, limits 1 m/s, 0.1 to 0.9, 1 rad."""
    numbers = {
        "speed": 1.0, "up": 1.0, "down": 1.0, "least_thrust": 0.1, "most_thrust": 0.9, "margin": 0.3, "tilt": 1.0,
        "hover": 0.5, "gravity": 9.80665,
    }  # fmt: skip
    rows = {name: torch.full((1, 1), value, dtype=torch.float64) for name, value in (numbers | changes).items()}
    ones = torch.ones(1, 3, dtype=torch.float64)
    return PositionGains(position=ones, velocity=20.0 * ones, integral=20.0 * ones, derivative=20.0 * ones, **rows)


def thrust_to(goal: list[float], gains: PositionGains) -> Tensor:
    """Return the thrust (1, 3), world, of the first run from rest at the origin to a position [m], in our frames."""
    none = torch.zeros(1, 3, dtype=torch.float64)
    error = limited_velocity(gains.position * torch.tensor([goal], dtype=torch.float64), gains)
    assert error[:, :2].norm() <= 1.0 + 1e-12
    assert error[0, 2].abs() <= 1.0
    return velocity_control(error, none, none, gains, 0.1)[1]


def test_the_most_thrust_keeps_a_margin_for_the_horizontal_part() -> None:
    """PX4's unit test PositionControlMaxThrustLimit: 10 m away on each axis, 0.9 in all, 0.3 of it sideways."""
    thrust = thrust_to([10.0, -10.0, 10.0], of_tests())
    side, up = 0.3 / sqrt(2.0), sqrt(0.9**2 - 0.3**2)
    torch.testing.assert_close(thrust, torch.tensor([[side, -side, up]], dtype=torch.float64), rtol=1e-12, atol=0)


def test_the_least_thrust_leans_to_the_limit() -> None:
    """PX4's unit test PositionControlMinThrustLimit: 10 m ahead and 10 m below, 0.1 in all, nose down by 1 rad."""
    thrust = thrust_to([10.0, 0.0, -10.0], of_tests())
    assert float(thrust.norm()) == pytest.approx(0.1, rel=1e-12)
    angles = euler_from_quat(attitude_from_thrust(thrust, torch.zeros(1, dtype=torch.float64)))
    torch.testing.assert_close(angles, torch.tensor([[0.0, 1.0, 0.0]], dtype=torch.float64), rtol=0, atol=1e-12)


@pytest.mark.parametrize("limit", [1.0, 0.5])
def test_the_lean_has_its_limit(limit: float) -> None:
    """PX4's unit test TiltLimit: 10 m aside both ways."""
    thrust = thrust_to([10.0, -10.0, 0.0], of_tests(tilt=limit))
    assert 0.0 < float(torch.acos(thrust[0, 2] / thrust.norm())) <= limit + 1e-9


def test_hover_idle_and_45_degrees_are_px4s() -> None:
    """PX4's unit tests UpdateHoverThrust (0.6 of nothing wanted), IdleThrustInput (100 m/s² down: 0.1), LimitTilt45degree."""
    torch.testing.assert_close(thrust_to([0.0] * 3, of_tests(hover=0.6)), torch.tensor([[0.0, 0.0, 0.6]]).double())
    idle = thrust_of(torch.tensor([[0.0, 0.0, -100.0]]).double(), of_tests())
    torch.testing.assert_close(idle, torch.tensor([[0.0, 0.0, 0.1]]).double())
    for x, y in ((1.0, 0.0), (0.0, 1.0)):
        axis = thrust_of(torch.tensor([[1e12 * x, 1e12 * y, 0.0]], dtype=torch.float64), of_tests(tilt=pi / 4))
        expected = sqrt(0.5) * torch.tensor([[x, y, 1.0]], dtype=torch.float64)
        torch.testing.assert_close(axis / axis.norm(), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("yaw", [0.0, pi / 2])
def test_thrust_straight_up_is_level_at_any_heading(yaw: float) -> None:
    """PX4's unit test ThrottleAttitudeMapping; straight down is none that its limits let through."""
    up, heading = (torch.tensor(part, dtype=torch.float64) for part in ([[0.0, 0.0, 1.0]], [yaw]))
    angles = euler_from_quat(attitude_from_thrust(up, heading))
    torch.testing.assert_close(angles, torch.tensor([[0.0, 0.0, yaw]], dtype=torch.float64), rtol=0, atol=1e-12)
