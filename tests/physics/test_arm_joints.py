"""Soft joints of the rotor arms: angles and wrenches against closed forms and against rotations by scipy."""

from dataclasses import replace
from math import cos, exp, sin

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym.config.robot import MountCfg, MountsCfg, RobotCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import EFFECTS, Model, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.effects import Condition, EffectsByKind, SubstepStart, WrenchEffect
from aerial_gym.physics.effects.arm_joint import LARGEST_ANGLE, ArmJoint
from aerial_gym.physics.memory import make_memory, replace_memory
from aerial_gym.physics.rigid_body import condition_in
from tests.physics.swing import fly_remembering
from tests.physics.vehicles import F64, asymmetric_robot, random_state, rest_state

Array = NDArray[np.float64]

NAMES = ("joint_spring", "joint_creep")

UPRIGHT = (0.0, 0.0, 1.0)


def joint(name: str) -> ArmJoint:
    return EFFECTS.get(name)


def cross_robot(count: int = 4, *, height: float = 0.0, distance: float = 0.2) -> RobotCfg:
    """Return a robot with upright rotors around the body axis, spins in turn, 1e-6 N per squared speed, com at the origin."""
    robot = asymmetric_robot(com=(0.0, 0.0, 0.0))
    turns = [2.0 * np.pi * k / count for k in range(count)]
    layout = tuple(
        MountCfg(position=(distance * cos(a), distance * sin(a), height), axis=UPRIGHT, spin=1 - 2 * (k % 2))
        for k, a in enumerate(turns)
    )
    rotor = replace(robot.rotor, thrust_map=(0.0, 0.0, 1e-6), torque_map=(0.0, 0.0, 2e-8))
    return replace(robot, rotor=rotor, mounts=MountsCfg(layout=layout, source="test"))


def make_model(robot: RobotCfg, *elements: tuple[str, tuple[float, float, float]], num_envs: int = 1) -> Model:
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    return build_model(vehicle, [(joint(n), torch.tensor([p] * num_envs, dtype=F64)) for n, p in elements])


def make_condition(model: Model, thrust: Tensor) -> Condition:
    """Return a vehicle at rest whose rotors push so much [N], (R,)."""
    speed = (thrust / 1e-6).sqrt().unsqueeze(0)
    return condition_in(model, replace(rest_state(1), rotor_speed=speed), torch.zeros_like(speed))


def arm_wrench(robot: RobotCfg, angles: Array, hinge: float, thrust: Array, drag: Array) -> Array:
    """Return the wrench (6,) about the centre of mass of rotors whose arms have turned, each a rotation by scipy."""
    total, com = np.zeros(6), np.array(robot.body.com)
    for mount, angle, push, q in zip(robot.mounts.layout, angles, thrust, drag, strict=True):
        hub, axis = np.array(mount.position), np.array(mount.axis) / np.linalg.norm(mount.axis)
        arm = (1.0 - hinge) * hub * (1.0, 1.0, 0.0)
        turn = Rotation.from_rotvec(angle * np.cross(hub * (1.0, 1.0, 0.0), UPRIGHT) / np.hypot(hub[0], hub[1]))
        force = push * turn.apply(axis)
        total[:3] += force
        total[3:] += np.cross(hub - arm + turn.apply(arm) - com, force) - mount.spin * q * turn.apply(axis)
    return total


@pytest.mark.parametrize("name", NAMES)
def test_an_element_approaches_the_load_exponentially(name: str) -> None:
    """``h = C f l (1 - exp(-t / tau))`` under a held thrust, however many substeps lead to t; l = 0.75 of 0.2 m."""
    compliance, tau, span = 0.3, 0.4, 0.3
    model = make_model(cross_robot(), (name, (compliance, tau, 0.25)))
    thrust = torch.tensor([1.0, 2.0, 3.0, 0.5], dtype=F64)
    speed = (thrust / 1e-6).sqrt().unsqueeze(0)
    for steps in (1, 7, 60):
        memory = make_memory(model, span / steps)
        assert memory.numbers.tolist() == [[0.0] * 4]
        _, memory = fly_remembering(
            model, memory, replace(rest_state(1), rotor_speed=speed), [speed] * steps, span / steps
        )
        expected = compliance * thrust * 0.15 * (1.0 - exp(-span / tau))
        torch.testing.assert_close(memory.numbers[0], expected, atol=1e-12, rtol=1e-9)


def test_without_a_lag_arms_rest_under_the_thrust_at_once() -> None:
    """tau -> 0: after any substep the angle is C f l."""
    model = make_model(cross_robot(), ("joint_spring", (0.3, 1e-9, 0.0)))
    speed = torch.full((1, 4), 1500.0, dtype=F64)
    now = SubstepStart(rotor_speed=speed, since=torch.zeros(1), random=torch.zeros(1), dt=1e-3, vehicle=model.vehicle)
    values = torch.cat((model.effects[WrenchEffect][0][1], torch.full((1, 4), 0.4, dtype=F64)), dim=1)
    result = joint("joint_spring").remember(now, values)
    torch.testing.assert_close(result, torch.full((1, 4), 0.3 * 2.25 * 0.2, dtype=F64), atol=0.0, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_wrench_is_that_of_turned_arms(name: str) -> None:
    """Tilted rotors, centre of mass beside the origin, unequal thrusts: against one rotation by scipy for each arm."""
    robot, hinge = asymmetric_robot(), 0.35
    model, state = make_model(robot, (name, (0.3, 0.5, hinge))), random_state(1)
    condition = condition_in(model, state, torch.zeros(1, 4, dtype=F64))
    speed, angles = state.rotor_speed[0].numpy(), np.array([0.1, -0.2, 0.3, 0.05])
    thrust, drag = 1e-4 * speed + 3e-6 * speed**2, 2e-6 * speed + 5e-8 * speed**2
    expected = arm_wrench(robot, angles, hinge, thrust, drag) - arm_wrench(robot, 0.0 * angles, hinge, thrust, drag)
    values = torch.cat((model.effects[WrenchEffect][0][1], torch.from_numpy(angles).unsqueeze(0)), dim=1)
    result = joint(name).wrench(condition, values)[0].numpy()
    np.testing.assert_allclose(result, expected, atol=1e-13, rtol=0.0)


def test_the_moment_about_the_hinge_does_not_depend_on_the_angle() -> None:
    """Virtual work: the thrust of a bent arm, at its hub, turns it by ``f l a_z``, which is what ``deflection`` takes."""
    robot, hinge, speed = asymmetric_robot(), 0.35, torch.full((1, 4), 900.0, dtype=F64)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    params = torch.tensor([[0.2, 0.02, hinge]], dtype=F64)
    rest = joint("joint_spring").deflection(vehicle, speed, params)[0].numpy()
    push = 1e-4 * 900.0 + 3e-6 * 900.0**2
    for mount, angle in zip(robot.mounts.layout, rest, strict=True):
        out, axis = np.array((*mount.position[:2], 0.0)), np.array(mount.axis) / np.linalg.norm(mount.axis)
        about = np.cross(out, UPRIGHT) / np.linalg.norm(out)
        for h in (-0.3, 0.0, 0.45):
            turn = Rotation.from_rotvec(h * about)
            moment = about @ np.cross(turn.apply((1.0 - hinge) * out), push * turn.apply(axis))
            assert abs(angle - 0.2 * moment) < 1e-12


def test_elements_in_series_add_their_angles() -> None:
    """Spring and creep together: the wrench of the sum of both angles, up to their products in the lift, ``f h1 h2``."""
    robot, thrust = cross_robot(), torch.tensor([1.0, 2.0, 1.5, 2.5], dtype=F64)
    model = make_model(robot, ("joint_spring", (0.1, 0.02, 0.4)), ("joint_creep", (0.15, 0.8, 0.4)))
    state = replace(rest_state(1), rotor_speed=(thrust / 1e-6).sqrt().unsqueeze(0))
    _, memory = fly_remembering(model, make_memory(model, 0.01), state, [state.rotor_speed] * 50, 0.01)
    moment, (fast, slow) = 0.12 * thrust, memory.numbers[0].split(4)
    torch.testing.assert_close(fast, 0.1 * moment * (1.0 - exp(-25.0)))
    torch.testing.assert_close(slow, 0.15 * moment * (1.0 - exp(-0.5 / 0.8)))
    condition, params = make_condition(model, thrust), [row for _, row in model.effects[WrenchEffect]]
    parts = [
        joint(name).wrench(condition, torch.cat((row, angle.unsqueeze(0)), dim=1))[0]
        for name, row, angle in zip(NAMES, params, (fast, slow), strict=True)
    ]
    drag = 0.02 * thrust.numpy()
    at_once = arm_wrench(robot, (fast + slow).numpy(), 0.4, thrust.numpy(), drag) - arm_wrench(
        robot, np.zeros(4), 0.4, thrust.numpy(), drag
    )
    products = (thrust * fast * slow).sum().item()
    missed = (parts[0] + parts[1]).numpy() - at_once
    assert abs(missed[2] - products) < 0.02 * products
    assert np.abs(missed[[0, 1, 3, 4, 5]]).max() < 0.2 * products


@pytest.mark.parametrize("name", NAMES)
def test_angles_end_at_a_stop(name: str) -> None:
    """One radian, however soft the joint, up or down."""
    model = make_model(cross_robot(), (name, (20.0, 0.3, 0.0)))
    speed = torch.full((1, 4), 2000.0, dtype=F64)
    rest = joint(name).deflection(model.vehicle, speed, model.effects[WrenchEffect][0][1])
    assert rest.tolist() == [[float(LARGEST_ANGLE)] * 4]
    pusher = replace(model.vehicle, rotor_axis=-model.vehicle.rotor_axis)
    rest = joint(name).deflection(pusher, speed, model.effects[WrenchEffect][0][1])
    assert rest.tolist() == [[-float(LARGEST_ANGLE)] * 4]


def test_the_angle_of_a_substep_is_that_of_its_middle() -> None:
    """A thrust that rises by 1 N/s, after 20 tau: ``C l (t + dt / 2 - tau)`` but for ``C l dt² / 12 tau``, dt = tau / 10."""
    compliance, tau, dt = 0.3, 0.2, 0.02
    model = make_model(cross_robot(), ("joint_spring", (compliance, tau, 0.0)))
    angles, start = torch.zeros(1, 4, dtype=F64), 0.0
    for step in range(200):
        start = step * dt
        speed = torch.full((1, 4), start / 1e-6, dtype=F64).sqrt()
        now = SubstepStart(rotor_speed=speed, since=torch.zeros(1), random=torch.zeros(1), dt=dt, vehicle=model.vehicle)
        angles = joint("joint_spring").remember(now, torch.cat((model.effects[WrenchEffect][0][1], angles), dim=1))
    missed = compliance * 0.2 * (start + 0.5 * dt - tau) - angles
    expected = torch.full_like(missed, compliance * 0.2 * dt**2 / (12.0 * tau))
    torch.testing.assert_close(missed, expected, rtol=0.01, atol=0.0)


def test_a_single_state_tells_the_force_if_the_angles_are_given() -> None:
    model, state = make_model(asymmetric_robot(), ("joint_spring", (0.3, 0.02, 0.4))), random_state(1)
    with pytest.raises(
        CapabilityError, match="effect joint_spring: has memory, so one state does not determine its force"
    ):
        accelerations(model, state)
    angles = torch.tensor([[0.1, 0.2, 0.3, -0.1]], dtype=F64)
    result = accelerations(model, state, remembered={"joint_spring": angles})
    memory = replace_memory(model, make_memory(model, 1e-9), {"joint_spring": angles})
    slow = replace(model, effects=EffectsByKind(((joint("joint_spring"), torch.tensor([[0.3, 1e3, 0.4]], dtype=F64)),)))
    after, _ = fly_remembering(slow, memory, state, [state.rotor_speed], 1e-6, "euler")
    torch.testing.assert_close((after.ang_vel - state.ang_vel) / 1e-6, result.ang_acc, atol=1e-3, rtol=1e-4)


def test_memory_is_placed_by_name() -> None:
    model = make_model(
        asymmetric_robot(), ("joint_spring", (0.3, 0.02, 0.4)), ("joint_creep", (0.3, 2.0, 0.4)), num_envs=2
    )
    angles = torch.arange(8.0, dtype=F64).view(2, 4)
    placed = replace_memory(model, make_memory(model, 0.01), {"joint_creep": angles}).numbers
    assert torch.equal(placed, torch.cat((torch.zeros(2, 4, dtype=F64), angles), dim=1))


def test_rotors_on_the_body_axis_do_not_bend() -> None:
    """Coaxial rotors: no angle, finite gradients; a robot of such rotors alone is refused by name."""
    layout = tuple(MountCfg(position=(0.0, 0.0, z), axis=UPRIGHT, spin=s) for z, s in ((0.05, 1), (-0.05, -1)))
    robot = replace(cross_robot(), mounts=MountsCfg(layout=layout, source="test"))
    with pytest.raises(ConfigError, match="effect joint_creep: all rotors are on the vertical axis"):
        joint("joint_creep").check(robot)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    hubs = vehicle.rotor_position.clone().requires_grad_()
    params = torch.tensor([[0.3, 0.02, 0.4]], dtype=F64)
    rest = joint("joint_spring").deflection(
        replace(vehicle, rotor_position=hubs), torch.full((1, 2), 900.0).double(), params
    )
    assert rest.abs().max() < 1e-6
    assert torch.isfinite(torch.autograd.grad(rest.sum(), hubs)[0]).all()
    joint("joint_spring").check(cross_robot())
