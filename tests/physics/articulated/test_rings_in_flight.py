"""Arms on springs in flight ring, or fade, against the reduced inertia of arms and body, not that of an arm on a stand.
Four arms alike, a point mass m at the end of each, length l, on a body of mass m0, M = m0 + 4 m. All droop by q
together. With the height z of the body, ``T = m0 z'²/2 + 2 m ((z' - l cos q q')² + (l sin q q')²)``; thrusts T turn
with the arms. Lagrange's equations without z: ``J q'' + c q' + V'(q) + T l (1 - (4 m/M) cos² q) = 0`` for slow q', and
about the angle of rest ``J q'' + c q' + k q = 0`` with ``J = m l² (1 - (4 m/M) cos² q)`` and ``k = V''(q) + (4 m/M) T l
sin 2 q``."""

import cmath
from dataclasses import replace
from math import cos, sin

import numpy as np
import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.flight import articulated_step
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS

F64 = torch.float64
ARM, LENGTH, BODY, G = 0.01625, 0.07, 0.225, STANDARD_GRAVITY
"""Of Morphy [kg], [m], [kg]; [m/s²]."""

QUADRATIC, REST, PRELOAD = 0.4646, 0.125, -0.01107181
"""Of its elevations: V'(q) = k2 |q - q0| (q - q0) - p."""


def arms(damping: float) -> RobotCfg:
    """Return Morphy with a damping of its joints [N m s/rad] and rotors without drag, which would turn arms aside."""
    robot = ROBOTS.get("morphy")
    layout = tuple(
        replace(joint, spring=replace(joint.spring, damping=damping), ends=None)
        for joint in robot.joints.layout
        if joint.spring is not None
    )
    rotor = replace(robot.rotor, torque_ratio=0.0)
    return replace(robot, rotor=rotor, joints=replace(robot.joints, layout=layout))


def hover() -> tuple[float, float]:
    """Return the angle of rest [rad] and the thrust of each rotor [N] in hover, by Newton's method."""
    whole, q = BODY + 4.0 * ARM, -0.2
    for _ in range(20):
        thrust = whole * G / (4.0 * cos(q))
        share = 4.0 * ARM / whole * cos(q) ** 2
        left = QUADRATIC * abs(q - REST) * (q - REST) - PRELOAD + thrust * LENGTH * (1.0 - share)
        q -= left / (2.0 * QUADRATIC * abs(q - REST))
    return q, whole * G / (4.0 * cos(q))


def rates(damping: float, *, flying: bool = True) -> tuple[complex, complex]:
    """Return the two s of ``exp(s t)`` [1/s], of arms in flight or on a stand under the same thrust."""
    q, thrust = hover()
    share = 4.0 * ARM / (BODY + 4.0 * ARM) if flying else 0.0
    inertia = ARM * LENGTH**2 * (1.0 - share * cos(q) ** 2)
    stiffness = 2.0 * QUADRATIC * abs(q - REST) + share * thrust * LENGTH * sin(2.0 * q)
    root = cmath.sqrt(damping**2 - 4.0 * inertia * stiffness)
    return (-damping + root) / (2.0 * inertia), (-damping - root) / (2.0 * inertia)


def at_hover(damping: float) -> tuple[Model, ArticulatedState, torch.Tensor]:
    robot = arms(damping)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, [], articulation=build_articulation(robot, like=vehicle.mass))
    angle, thrust = hover()
    thrusts = torch.full((1, 4), thrust, dtype=F64)
    body = replace(state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64), rotor_speed=thrusts)
    joints = torch.tensor([[angle, 0.0] * 4], dtype=F64)
    return model, ArticulatedState(**vars(body), joint_pos=joints, joint_vel=torch.zeros_like(joints)), thrusts


def fit_rates(damping: float, dt: float, num_steps: int) -> np.ndarray:
    """Return the two rates of a flight in which all arms are pushed down at once, by a fit of
    ``x_k+2 = a x_k+1 + b x_k + d``; d is what the angle of rest is off by the rounded numbers of the robot file."""
    model, state, thrusts = at_hover(damping)
    rest = float(state.joint_pos[0, 0])
    push = torch.tensor([[3e-3, 0.0] * 4], dtype=F64)
    state = replace(state, joint_vel=push)
    away = []
    for _ in range(num_steps):
        state = articulated_step(model, state, thrusts, thrusts[:, :0], dt)
        away.append(float(state.joint_pos[0, 0]) - rest)
    assert float(state.ang_vel.abs().max()) < 1e-12
    x = np.array(away)
    result, *_ = np.linalg.lstsq(np.stack((x[1:-1], x[:-2], np.full(len(x) - 2, x.std())), axis=1), x[2:], rcond=None)
    return np.log(np.roots([1.0, -result[0], -result[1]]).astype(complex)) / dt


def test_arms_hover_where_lagrange_says() -> None:
    model, state, thrusts = at_hover(0.01825324)
    for _ in range(20):
        state = articulated_step(model, state, thrusts, thrusts[:, :0], 2e-3)
    torch.testing.assert_close(state.lin_vel, torch.zeros_like(state.lin_vel), rtol=0.0, atol=1e-6)
    torch.testing.assert_close(state.joint_vel, torch.zeros_like(state.joint_vel), rtol=0.0, atol=1e-5)


@pytest.mark.parametrize(
    "damping", [pytest.param(0.01825324, marks=pytest.mark.slow), 0.0005], ids=["as published", "soft"]
)
def test_arms_pushed_in_flight_move_with_the_reduced_inertia(damping: float) -> None:
    """Rates of exp(s t); the step is of order 1: they come twice as near with half of it, and in its limit they are right.
    The published damping fades, a 36th of it rings."""
    right = sorted(rates(damping), key=lambda s: (s.imag, s.real))
    steps = [2e-4, 1e-4]
    seen = [sorted(fit_rates(damping, dt, round(0.016 / dt)), key=lambda s: (s.imag, s.real)) for dt in steps]
    print()
    for exact, coarse, fine, stand in zip(
        right, *seen, sorted(rates(damping, flying=False), key=lambda s: (s.imag, s.real)), strict=True
    ):
        limit = 2.0 * fine - coarse
        print(f"flight {exact:.2f}, flown {limit:.2f}, on a stand {stand:.2f} 1/s")
        assert abs(coarse - exact) / abs(fine - exact) == pytest.approx(2.0, abs=0.1)
        assert abs(limit - exact) < 2e-3 * abs(exact)
        assert abs(stand - exact) > 0.02 * abs(exact)
