"""``joint_spring`` and ``joint_creep`` of a rigid vehicle are what its arms on joints do when thrust changes slowly.
Four arms of length l on springs 1/C with dampers tau/C; each has an inertia J about its hinge and its centre of mass on
it, so that what the body does does not move it. All thrusts go up and down together, ``T0 + A sin w t``. The joints
follow ``J q'' + (tau q' + q) / C = T l``, the effects ``tau h' + h = C T l``: with ``s = i w`` they differ by ``C A l
(1 / (1 + tau s + C J s²) - 1 / (1 + tau s))``, which is ``w² C J`` of the angle for small w.
Arms on springs in flight ring, or fade, against the reduced inertia of arms and body, not that of an arm on a stand.
Four arms alike, a point mass m at the end of each, length l, on a body of mass m0, M = m0 + 4 m. All droop by q
together. With the height z of the body, ``T = m0 z'²/2 + 2 m ((z' - l cos q q')² + (l sin q q')²)``; thrusts T turn
with the arms. Lagrange's equations without z: ``J q'' + c q' + V'(q) + T l (1 - (4 m/M) cos² q) = 0`` for slow q', and
about the angle of rest ``J q'' + c q' + k q = 0`` with ``J = m l² (1 - (4 m/M) cos² q)`` and ``k = V''(q) + (4 m/M) T l
sin 2 q``.
"""

import cmath
from dataclasses import replace
from math import cos, log2, pi, sin

import numpy as np
import pytest
import torch

from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import MountCfg, MountsCfg, RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics import EFFECTS
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.flight import articulated_step
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering

F64 = torch.float64
COMPLIANCE, HUB, HINGE = 1.0, 0.12, 0.05
"""[rad/(N m)]; from the body's axis [m]."""

LENGTH, THRUST, SWING = HUB - HINGE, 0.7, 0.07
"""Of an arm [m]; mean and amplitude of each rotor [N]."""

SPEEDS = torch.tensor([20.0, 10.0, 5.0], dtype=F64)
"""w of the three environments [rad/s], for a time constant of 0.01 s and arms that swing at 100 rad/s."""


def rigid() -> RobotCfg:
    """Return a quadrotor in a cross, whose rotors have no drag."""
    robot = ROBOTS.get("morphy_stiff")
    places = ((HUB, 0.0, 0.0), (0.0, HUB, 0.0), (-HUB, 0.0, 0.0), (0.0, -HUB, 0.0))
    layout = tuple(MountCfg(position=place, spin=1 - 2 * (k % 2)) for k, place in enumerate(places))
    return replace(
        robot, rotor=replace(robot.rotor, torque_ratio=0.0), mounts=MountsCfg(layout=layout, source="test"),
        collision=replace(robot.collision, spheres=(), boxes=(), capsules=()),
    )  # fmt: skip


def add_joints(tau: float, inertia: float) -> RobotCfg:
    robot, own = rigid(), ((inertia, 0.0, 0.0), (0.0, inertia, 0.0), (0.0, 0.0, inertia))
    joints, mounts = [], []
    for k, mount in enumerate(robot.mounts.layout):
        x, y, _ = (each / HUB for each in mount.position)
        hinge = (HINGE * x, HINGE * y, 0.0)
        joints.append(
            JointCfg(
                name=f"arm_{k}", axis=(y, -x, 0.0), position=hinge, link=LinkCfg(mass=1e-3, com=hinge, inertia=own),
                spring=SpringCfg(stiffness=1.0 / COMPLIANCE, damping=tau / COMPLIANCE),
            )
        )  # fmt: skip
        mounts.append(replace(mount, link=f"arm_{k}"))
    whole = tuple(
        tuple(value + (4.0 * inertia if i == j else 0.0) for j, value in enumerate(row))
        for i, row in enumerate(robot.body.inertia)
    )
    return replace(
        robot, body=replace(robot.body, inertia=whole), mounts=MountsCfg(layout=tuple(mounts), source="test"),
        joints=JointsCfg(layout=tuple(joints), source="test"),
    )  # fmt: skip


def make_model(robot: RobotCfg, effects: list) -> Model:
    vehicle = vehicle_from_config(robot, num_envs=len(SPEEDS), dtype=F64)
    return build_model(vehicle, effects, articulation=build_articulation(robot, like=vehicle.mass))


def amplitude(rows: list[torch.Tensor], phase: list[torch.Tensor], last: torch.Tensor) -> torch.Tensor:
    """Return the complex amplitude X of ``Im(X exp(i w t))`` in the last period, (E,), of rows (E,) at phases (E,)."""
    value, turns = torch.stack(rows), torch.exp(-1j * torch.stack(phase))
    seen = torch.arange(len(rows)).unsqueeze(1) >= len(rows) - last
    mean = (value * seen).sum(0) / seen.sum(0)
    return 2j * ((value - mean) * turns * seen).sum(0) / seen.sum(0)


def swings(name: str, scale: float, dt: float) -> torch.Tensor:
    """Return amplitudes of the joint and of the effect [rad], and of the upward accelerations of both bodies [m/s²], (4, E).

    Args:
        name: Of the effect.
        scale: By which all times are longer than those of ``SPEEDS``.
        dt: Step, before that [s].
    """
    speeds, step = SPEEDS / scale, dt * scale
    tau, inertia = 0.01 * scale, 1e-4 * scale**2 / COMPLIANCE
    params = torch.tensor([[COMPLIANCE, tau, HINGE / HUB]], dtype=F64).expand(len(SPEEDS), -1)
    arms, still = make_model(add_joints(tau, inertia), []), make_model(rigid(), [(EFFECTS.get(name), params)])
    rest = torch.full((len(SPEEDS), 4), COMPLIANCE * THRUST * LENGTH, dtype=F64)
    body = state_at_rest(len(SPEEDS), 4, device=torch.device("cpu"), dtype=F64)
    body = replace(body, rotor_speed=torch.full_like(rest, THRUST))
    bent = ArticulatedState(**vars(body), joint_pos=rest, joint_vel=torch.zeros_like(rest))
    memory = replace(make_memory(still, step), numbers=rest.clone())
    periods = (2.0 * pi / (speeds * step)).round()
    angles: list[list[torch.Tensor]] = [[], [], [], []]
    phases = []
    for k in range(int(periods.max()) + round(0.16 / dt)):
        phase = speeds * step * (k + 1)
        thrust = (THRUST + SWING * torch.sin(phase)).unsqueeze(1).expand(-1, 4)
        before = bent.lin_vel[:, 2], body.lin_vel[:, 2]
        bent, body = replace(bent, rotor_speed=thrust), replace(body, rotor_speed=thrust)
        bent = articulated_step(arms, bent, thrust, thrust[:, :0], step)
        body, memory = fly_remembering(still, memory, body, [thrust], step, "euler")
        rising = [(now.lin_vel[:, 2] - old) / step for now, old in zip((bent, body), before, strict=True)]
        for seen, value in zip(angles, (bent.joint_pos[:, 0], memory.numbers[:, 0], *rising), strict=True):
            seen.append(value)
        phases.append(phase)
    return torch.stack([amplitude(seen, phases, periods) for seen in angles])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scale"), [("joint_spring", 1.0), ("joint_creep", 30.0)])
def test_arms_on_joints_follow_slow_thrust_as_the_effect_does(name: str, scale: float) -> None:
    """The difference is the closed form's within 5 %, and falls with w²: order 2 within 0.1, also of the body's motion.
    Steps are of order 1: both are extrapolated from 2 ms and 1 ms."""
    coarse, fine = (swings(name, scale, dt) for dt in (2e-3, 1e-3))
    joint, effect, rise, rigid_rise = 2.0 * fine - coarse
    s, load = 1j * SPEEDS, COMPLIANCE * SWING * LENGTH
    expected = load * (1.0 / (1.0 + 0.01 * s + 1e-4 * s * s) - 1.0 / (1.0 + 0.01 * s))
    apart, risen = joint - effect, (rise - rigid_rise).abs()
    orders = [log2(float(each[1] / each[2])) for each in (apart.abs(), risen)]
    shares = [f"{share:.4f}" for share in (apart / joint).abs().tolist()]
    print(f"\n{name}: of the angle {shares}, orders {orders[0]:.2f}, {orders[1]:.2f}")
    torch.testing.assert_close(apart.abs(), expected.abs(), rtol=0.05, atol=0.0)
    assert bool(((apart - expected).abs() < 0.1 * expected.abs()).all())
    assert orders == pytest.approx([2.0, 2.0], abs=0.1)
    lean = 4.0 * THRUST * sin(COMPLIANCE * THRUST * LENGTH) / ROBOTS.get("morphy_stiff").body.mass
    torch.testing.assert_close(risen, lean * apart.abs(), rtol=0.1, atol=0.0)


ARM, RING_LENGTH, BODY, G = 0.01625, 0.07, 0.225, STANDARD_GRAVITY
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
        left = QUADRATIC * abs(q - REST) * (q - REST) - PRELOAD + thrust * RING_LENGTH * (1.0 - share)
        q -= left / (2.0 * QUADRATIC * abs(q - REST))
    return q, whole * G / (4.0 * cos(q))


def rates(damping: float, *, flying: bool = True) -> tuple[complex, complex]:
    """Return the two s of ``exp(s t)`` [1/s], of arms in flight or on a stand under the same thrust."""
    q, thrust = hover()
    share = 4.0 * ARM / (BODY + 4.0 * ARM) if flying else 0.0
    inertia = ARM * RING_LENGTH**2 * (1.0 - share * cos(q) ** 2)
    stiffness = 2.0 * QUADRATIC * abs(q - REST) + share * thrust * RING_LENGTH * sin(2.0 * q)
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
