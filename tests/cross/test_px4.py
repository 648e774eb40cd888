"""PX4's cascade against PX4's own control libraries: golden vectors of 10,000 random states each.

``tests/cross/firmware/px4_vectors.py`` made them. Its frames are north, east, down and forward, right, down; ours have y and z
the other way round, so everything is compared after two changes of sign.
"""

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.control.px4.attitude import attitude_from_thrust, canonical, shortest_turn, wanted_rates
from aerial_gym.control.px4.position import PositionGains, limited_velocity, velocity_control
from aerial_gym.control.px4.rates import grown_integral, rate_torque
from aerial_gym.math.quaternion import quat_conjugate, quat_exp, quat_from_euler, quat_multiply, quat_rotate
from tests.cross.firmware import px4_vectors as made

EPS = 2.0**-24
"""Half a unit in the last place of float32, in which PX4 computes."""

GRAVITY = 9.80665
"""PX4's."""


@pytest.fixture(scope="module")
def vectors() -> dict[str, Tensor]:
    with np.load(made.VECTORS) as file:
        assert int(file["checksum"]) == made.checksum(), (
            "the random states are not those of the vectors: make them anew"
        )
        return {name: torch.from_numpy(file[name]).double() for name in ("torque", "rate", "position")}


def turned(rows: Tensor) -> Tensor:
    """Return vectors (..., 3) in the other convention: y and z change their signs."""
    return rows * rows.new_tensor((1.0, -1.0, -1.0))


def quat(rows: Tensor) -> Tensor:
    """Return quaternions wxyz of PX4's frames (..., 4) as xyzw of ours."""
    return torch.cat((turned(rows[..., 1:]), rows[..., :1]), dim=-1)


def split(rows: np.ndarray, *widths: int) -> list[Tensor]:
    return list(torch.from_numpy(rows).double().split(widths, dim=-1))


def test_rate_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Four runs after each other, with integral, feed-forward, limits and saturated rotors."""
    gains, states = made.rate_states()
    p, i, d, forward, limit = split(gains, 3, 3, 3, 3, 3)
    rate, wanted, ang_acc, short, dt = (part.unbind(1) for part in split(states, 3, 3, 3, 3, 1))
    integral = torch.zeros_like(p)
    for k in range(made.STEPS):
        w, w_d, a, s = (turned(x[k]) for x in (rate, wanted, ang_acc, short))
        torque = rate_torque(w_d - w, w_d, a, integral, (p, d, forward))
        integral = grown_integral(integral, w_d - w, s, i, limit, dt[k])
        size = (p * (w_d - w)).abs() + integral.abs() + (d * a).abs() + 1.0
        assert ((torque - turned(vectors["torque"][:, k])).abs() <= 8 * EPS * size).all()


def test_attitude_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """From any attitude to any other.

    Rounding grows where the turn is ill-conditioned: between opposite tilts by the length n of half the turn between them, and
    where the heading error w, z nears 0 or 180 degrees, as PX4 takes arc cosine and arc sine, which lose digits there.
    """
    attitude, wanted, yaw_rate, gain, weight, limit = split(made.attitude_states(), 4, 4, 1, 3, 1, 3)
    attitude, wanted = quat(attitude), quat(wanted)
    rates = wanted_rates(attitude, wanted, -yaw_rate[:, 0], gain=gain, yaw_weight=weight, limit=limit)
    up, goal = (quat_rotate(q, q.new_tensor((0.0, 0.0, 1.0)).expand(len(q), 3)) for q in (attitude, wanted))
    turn, _ = shortest_turn(up, goal)
    heading = canonical(quat_multiply(quat_conjugate(quat_multiply(turn, attitude)), wanted)).abs()
    n = (2.0 + 2.0 * (up * goal).sum(-1)).sqrt()
    growth = 1.0 / n + 1.0 / heading[:, 3] + 1.0 / heading[:, 2]
    bound = 8 * EPS * gain.amax(-1) / weight[:, 0] * growth
    error = (rates - turned(vectors["rate"])).abs().amax(-1)
    assert len(error) == 10_000
    assert (error <= bound).all()
    assert float(error.median()) < 2e-6


def test_position_control_is_px4s(vectors: dict[str, Tensor]) -> None:
    """Four runs after each other, to positions or velocities, against all limits: acceleration, thrust and attitude."""
    gains, states = made.position_states()
    position, velocity, integral_gain, derivative, *limits = split(gains, 3, 3, 3, 3, *[1] * 8)
    speed, up, down, least, most, margin, tilt, hover = limits
    ours = PositionGains(
        position=position, velocity=velocity, integral=integral_gain, derivative=derivative, speed=speed, up=up, down=down,
        least_thrust=least.clamp_min(1e-3), most_thrust=most, margin=margin, tilt=tilt, hover=hover,
        gravity=torch.full_like(hover, GRAVITY),
    )  # fmt: skip
    steps = [part.unbind(1) for part in split(states, 3, 3, 3, 3, 1, 1, 1)]
    integral, limited = torch.zeros_like(position), 0
    for k in range(made.STEPS):
        at, moving, measured, goal = (turned(part[k]) for part in steps[:4])
        yaw, dt, is_velocity = (part[k] for part in steps[4:])
        wanted = torch.where(is_velocity > 0.5, goal, position * (goal - at))
        error = limited_velocity(wanted, ours) - moving
        acceleration, thrust, integral = velocity_control(error, integral, measured, ours, dt)
        found = attitude_from_thrust(thrust, -yaw[:, 0])
        theirs = vectors["position"][:, k]
        size = (velocity * error).abs().amax(-1, keepdim=True) + integral.abs().amax(-1, keepdim=True) + 1.0
        assert ((acceleration - turned(theirs[:, :3])).abs() <= 16 * EPS * size).all()
        torch.testing.assert_close(thrust, turned(theirs[:, 3:6]), atol=4e-6, rtol=0)
        torch.testing.assert_close(canonical(found), canonical(quat(theirs[:, 6:])), atol=4e-6, rtol=0)
        limited += int((thrust.norm(dim=-1) > most[:, 0] - 1e-6).sum())
    assert limited > 1000  # so many of the states are at the limit of thrust, or the test would not see it


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
