"""What the joints of snakes bear: on a stand, in hover in any shape, and while thrusts differ to turn the vehicle."""

import pytest
import torch

from aerial_gym.robots import ROBOTS
from tests.physics.articulated.snakes import F64, STIFFNESS, G, SnakeHover

MASS, LENGTH, TORQUE_RATIO = 0.30625, 1.0, 0.01
"""Of a rod [kg], [m]; drag torque per thrust [m]."""

ROLL_LIMIT = 0.3
"""Largest effort of a drive in roll [N m]."""


def test_a_stand_needs_more_than_drives_in_roll_can_give() -> None:
    """Without thrust rods at right angles hang on a roll joint by ``m g`` times how far beside its axis their middles are.
    That is L/2 and L of the two rods beyond roll_1 and L/2 beyond roll_2: 15 and 5 times the limit. Rod 2 lies along -x from
    a joint whose axis is +y: its weight turns the joint by ``r x F = (-L/2, 0, 0) x (0, 0, -m g) = -m g L/2 y``."""
    hover = SnakeHover.from_robot(ROBOTS.get("snakey"))
    load, _, _ = hover.on_joints(hover.articulation.reference, 0.0 * hover.equal_thrusts, floating=False)
    weight = MASS * G * LENGTH
    expected = torch.tensor([0.0, -1.5 * weight, 0.0, -0.5 * weight, 0.0, 0.0], dtype=F64)
    torch.testing.assert_close(load, expected, rtol=1e-9, atol=1e-12)
    for name in ("snakey", "snakey5", "snakey6"):
        hover = SnakeHover.from_robot(ROBOTS.get(name))
        most = float(
            hover.on_joints(hover.articulation.reference, 0.0 * hover.equal_thrusts, floating=False)[0].abs().max()
        )
        print(f"\n{name}: {most:.1f} N m on a stand, drives give {ROLL_LIMIT} N m")
        assert most > ROLL_LIMIT


@pytest.mark.parametrize("name", ["snakey", "snakey6"])
def test_rods_that_carry_themselves_load_only_yaw_and_by_the_drag_of_rotors(name: str) -> None:
    """In any level shape: a joint in yaw bears the drag torque of the rods beyond it, which is that of one rotor or none.
    Rotor 0 turns positively, so that its drag is ``-0.01 m f`` about z and that of rotor 1 ``+0.01 m f``."""
    hover = SnakeHover.from_robot(ROBOTS.get(name))
    gen = torch.Generator().manual_seed(0)
    shape = hover.articulation.reference.clone()
    shape[0::2] += torch.rand(len(shape) // 2, generator=gen, dtype=F64) - 0.5
    load, _, _ = hover.on_joints(shape, hover.equal_thrusts)
    torch.testing.assert_close(load[1::2], torch.zeros_like(load[1::2]), rtol=0.0, atol=1e-12)
    drag = TORQUE_RATIO * MASS * G * torch.tensor([(1.0, 0.0)[k % 2] for k in range(len(load) // 2)], dtype=F64)
    torch.testing.assert_close(load[0::2], drag, rtol=1e-9, atol=1e-12)


def yaw_per_thrust(name: str, stiffness: float) -> float:
    """Return the torque about z per thrust by which rotors of the two directions differ [m], once drives to angles of a
    stiffness [N m/rad] have given way to it by load over stiffness."""
    hover = SnakeHover.from_robot(ROBOTS.get(name))
    spins, com = hover.model.vehicle.rotor_spin[0], hover.model.vehicle.com[0]
    step, pose, turning = 1e-4, hover.articulation.reference, []
    for side in (step, -step):
        thrust = hover.equal_thrusts + side * (spins.mean() - spins)
        load, _, _ = hover.on_joints(pose, thrust)
        _, _, whole = hover.on_joints(pose + load / stiffness, thrust)
        turning.append(float(whole[5] - torch.linalg.cross(com, whole[:3])[2]))
    return (turning[0] - turning[1]) / (2.0 * step)


@pytest.mark.parametrize(("name", "rods", "sign"), [("snakey", 4, 1), ("snakey5", 5, 1), ("snakey6", 6, -1)])
def test_six_rods_give_way_so_far_that_thrusts_turn_them_the_other_way(name: str, rods: int, sign: int) -> None:
    """Thrusts that differ twist rods, which then push sideways; drag turns the whole by 0.01 m a rotor. (Spins s of five
    rods do not sum to zero: ``sum s (s - mean)`` is 4.8.) What twist takes off falls with the stiffness: ten times as stiff
    drives lose a tenth. (Five lose nothing.) With those of the robot files six rods turn against what their controller asks
    for."""
    straight = yaw_per_thrust(name, 1e9)
    soft, firm = yaw_per_thrust(name, STIFFNESS), yaw_per_thrust(name, 10.0 * STIFFNESS)
    print(f"\n{name}: {straight:.4f} m on stiff joints, {soft:.4f} m on the drives")
    assert straight == pytest.approx(TORQUE_RATIO * (4.8 if rods == 5 else rods), rel=1e-6)
    assert soft * sign > 0.0
    assert firm > 0.0
    assert soft - straight == pytest.approx(10.0 * (firm - straight), rel=1e-3, abs=1e-3 * straight)
