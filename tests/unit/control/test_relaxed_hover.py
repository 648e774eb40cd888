"""The relaxed hover of a quadrotor without a rotor: balances in closed form, the source's own numbers, the simulator's step."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest
import torch
from scipy.linalg import expm
from torch import Tensor

from aerial_gym.config.robot import MountsCfg, RobotCfg
from aerial_gym.control.lost_rotor import declared_model
from aerial_gym.control.reduced_attitude import shortest_turn, up_axis
from aerial_gym.control.relaxed_hover import (
    PLACE,
    ROTORS,
    TURN,
    UP,
    VELOCITY,
    linearised,
    motion_from_body,
    relaxed_hover,
)
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_multiply, quat_rotate
from aerial_gym.physics import BodyState
from aerial_gym.physics.memory import make_memory
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.vehicles import lopsided_robot

GRAVITY, ROBOT = 9.81, ROBOTS.get("base_quadrotor_braked_in_spin")
MODEL = declared_model(ROBOT, GRAVITY)


@pytest.mark.parametrize("lost", range(4))
@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
def test_forces_and_torques_balance(lost: int, share: float) -> None:
    """Newton and Euler in the body: ``m (w x v) = sum F - m g u``, ``w x J w = sum r x F - s q z``."""
    motion = relaxed_hover(MODEL, lost, share).numpy()
    place, velocity, up, turn, speed = (motion[part] for part in (PLACE, VELOCITY, UP, TURN, ROTORS))
    hubs = np.array([mount.position for mount in ROBOT.mounts.layout])
    spins, inertia = np.array([mount.spin for mount in ROBOT.mounts.layout]), np.array(ROBOT.body.inertia)
    kh, mass = ROBOT.effects["h_force_flapping"]["kh"], ROBOT.body.mass
    thrust = 3.485449e-7 * speed**2
    force = -kh * speed[:, None] * (velocity + np.cross(turn, hubs)) * (1.0, 1.0, 0.0)
    force[:, 2] += thrust
    torque = np.cross(hubs, force).sum(0) - (0.0, 0.0, 0.01 * (spins @ thrust))
    np.testing.assert_allclose(np.cross(turn, inertia @ turn), torque, atol=1e-9)
    np.testing.assert_allclose(mass * np.cross(turn, velocity), force.sum(0) - mass * GRAVITY * up, atol=1e-9)
    assert up @ force.sum(0) == pytest.approx(
        mass * GRAVITY, abs=1e-9
    )  # along the axis of the spin it carries the weight
    np.testing.assert_allclose(np.cross(turn, up), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.cross(turn, place), velocity, atol=1e-9)  # the body origin circles the target
    assert place @ up == pytest.approx(0.0, abs=1e-9)
    beside = [(lost + 1) % 4, (lost + 3) % 4]
    assert thrust[beside] == pytest.approx(thrust[beside][::-1], abs=1e-9)
    assert thrust[(lost + 2) % 4] == pytest.approx(share * thrust[beside[0]], abs=1e-9)
    assert speed[lost] == 0.0
    assert up[2] > 0.5
    assert turn[2] * spins[lost] > 0.0  # rotors beside it turn against it, and their drag torque turns the body its way


def of_the_source() -> RobotCfg:
    """Return the vehicle of the source, as public implementations of the paper agree on it: placed as ours."""
    hub, root = 0.17, sqrt(0.5)
    body = replace(ROBOT.body, mass=0.5, inertia=((3.2e-3, 0.0, 0.0), (0.0, 3.2e-3, 0.0), (0.0, 0.0, 5.5e-3)))
    assert ROBOT.rotor is not None
    rotor = replace(ROBOT.rotor, thrust_map=(0.0, 0.0, 6.41e-6), torque_ratio=1.69e-2, thrust_range=(0.2, 3.8))
    places = ((1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0))
    layout = tuple(
        replace(mount, position=(hub * root * x, hub * root * y, 0.0))
        for mount, (x, y) in zip(ROBOT.mounts.layout, places, strict=True)
    )
    speeds = sqrt(2.05 / 6.41e-6), sqrt(1.025 / 6.41e-6)
    braking = 2.75e-3 / (hub**2 * (2.0 * speeds[0] + speeds[1]))
    return replace(
        ROBOT,
        body=body,
        rotor=rotor,
        mounts=MountsCfg(layout=layout, source="test"),
        effects={"h_force_flapping": {"kh": braking, "kf": 0.0}, "rotor_inertia": {"jr": 1.5e-5}},
    )


def test_the_vehicle_of_the_source_hovers_as_the_source_says() -> None:
    """2.05, 1.025 and 2.05 N, 18.89 rad/s about z, lean of n 0.289; here what brakes the spin pushes sideways too.

    Without the momentum of its propellers the lean is 27 % less.
    """
    model = declared_model(of_the_source(), GRAVITY)
    motion = relaxed_hover(model, 3, 0.5)
    thrust = 6.41e-6 * motion[ROTORS] ** 2
    assert thrust[[0, 1, 2, 3]].tolist() == pytest.approx([2.05, 1.025, 2.05, 0.0], rel=0.01)
    assert motion[TURN][2].abs().item() == pytest.approx(18.89, rel=0.02)
    assert motion[UP][:2].norm().item() == pytest.approx(0.289, rel=0.05)
    assert motion[TURN][:2].norm().item() == pytest.approx(5.69, rel=0.05)


def stepped(robot: RobotCfg, motions: Tensor, commands: Tensor, dt: float) -> Tensor:
    """Return motions (E, M) after one step of the simulator, RK4, in any heading, from commands (E, R)."""
    count = len(motions)
    model, target = declared_model(robot, GRAVITY, num_envs=count), torch.tensor([[3.0, -2.0, 5.0]]).double()
    tilt, _ = shortest_turn(motions[:, UP], up_axis(motions))
    attitude = quat_multiply(quat_from_euler(torch.tensor([[0.0, 0.0, 0.7]]).double()).expand(count, 4), tilt)
    start = BodyState(
        position=target + quat_rotate(attitude, motions[:, PLACE]),
        attitude=attitude,
        lin_vel=quat_rotate(attitude, motions[:, VELOCITY]),
        ang_vel=motions[:, TURN],
        rotor_speed=motions[:, ROTORS],
    )
    end, _ = fly_remembering(model, make_memory(model, dt), start, [commands], dt)
    return motion_from_body(end, target)


@pytest.mark.parametrize(("robot", "lost"), [*((ROBOT, lost) for lost in range(4)), (of_the_source(), 3)])
def test_the_linear_motion_is_that_of_the_simulator(robot: RobotCfg, lost: int) -> None:
    """After 5 ms of held commands ``x = e^(A t) x0 + G u``, both by central differences of a step."""
    model, dt = declared_model(robot, GRAVITY), 0.005
    motion = relaxed_hover(model, lost, 0.1)
    a, b, rows = linearised(model, motion, lost)
    kept, states = [i for i in range(4) if i != lost], len(a)
    held = expm(np.block([[a.numpy(), b.numpy()], [np.zeros((3, states + 3))]]) * dt)[:states]
    size = torch.tensor([1e-4] * 11 + [1e-2] * 3 + [1e-2] * 3, dtype=torch.float64)
    nudge = torch.cat((size.diag(), -size.diag()))
    command = motion[ROTORS].repeat(len(nudge), 1)
    command[:, kept] += nudge[:, states:]
    off = (stepped(robot, motion + nudge[:, :states] @ rows, command, dt) - motion) @ rows.T
    found = (off[: len(size)] - off[len(size) :]).T / (2.0 * size)
    torch.testing.assert_close(found, torch.from_numpy(held), rtol=0.0, atol=3e-6)


def test_nothing_moves_seen_from_the_body() -> None:
    for lost in range(4):
        motion = relaxed_hover(MODEL, lost, 0.2).unsqueeze(0)
        later = motion
        for _ in range(20):
            later = stepped(ROBOT, later, motion[:, ROTORS], 0.01)
        torch.testing.assert_close(later, motion, rtol=0.0, atol=1e-5)


def test_a_mirrored_vehicle_hovers_mirrored() -> None:
    """Across the plane of x and z rotors 1 and 4, 2 and 3 change places, and with them the sense of their turning."""
    left, right = relaxed_hover(MODEL, 0, 0.1), relaxed_hover(MODEL, 3, 0.1)
    mirror = torch.tensor([1.0, -1.0, 1.0] * 3 + [-1.0, 1.0, -1.0], dtype=torch.float64)
    torch.testing.assert_close(right[:12], mirror * left[:12], rtol=0.0, atol=1e-9)
    torch.testing.assert_close(right[ROTORS], left[ROTORS].flip(0), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "share", "message"),
    [
        (ROBOTS.get("base_quadrotor"), 0.1, "brakes it"),
        (ROBOT, 0.5, "smaller share"),
        (ROBOTS.get("typhoon_hexarotor"), 0.1, "is for quadrotors"),
        (ROBOTS.get("morphy_stiff"), 0.1, "of plain rotors"),
        (lopsided_robot(), 0.1, "along body z"),
    ],
)
def test_vehicles_that_cannot_are_refused(robot: RobotCfg, share: float, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        relaxed_hover(declared_model(robot, GRAVITY), 0, share)


def test_rotors_that_turn_otherwise_are_refused() -> None:
    """With both rotors of a side alike their torque does not turn the body when the others are gone."""
    layout = ROBOT.mounts.layout
    spins = tuple(replace(mount, spin=spin) for mount, spin in zip(layout, (1, 1, -1, -1), strict=True))
    with pytest.raises(ConfigError, match="same way"):
        relaxed_hover(declared_model(replace(ROBOT, mounts=replace(ROBOT.mounts, layout=spins)), GRAVITY), 0, 0.1)
