"""Snakes that hold their shape and fold in the air, in each mode of their drives, each rotor carrying its rod.
Environments of one batch: told to stay; to fold and to unfold by 0.2 rad at each joint in yaw within 2 s.
Snakes whose joints are told to keep the shape, flown as if they were stiff by a law that knows the inertia of that
shape. Their drives hold no more than 0.3 N m in roll. Four and five rods stay a polygon; six, or any whose drives are
told rates, give way while they hover: rods that twist by the differing thrusts of a yaw command turn the torque of six
about z around (docs/results/joints.md). Drives reach their limit only after that. Half the step gives way at the same
time: the vehicle causes it, not the method.
"""

from dataclasses import dataclass, replace

import pytest
import torch

from aerial_gym import ROBOTS, SIMS
from tests.builders import simulation
from tests.physics.articulated.snakes import DAMPING, F64, SnakeHover

pytestmark = pytest.mark.slow

FOLD, RAMP, SECONDS = 0.2, 2.0, 5.0
"""By how much each joint in yaw turns [rad], within which time [s], and how long it is flown [s]."""

ROUND_OFF = 1e-5
"""Where a joint in float32 stops on its way to rest [rad]: steps of 2 ms at a rate of less than half a unit in the last place
of its angle, 3e-5 rad/s, add nothing; at this rate it is ``c / k`` times as far away, 6e-6 rad."""


@dataclass(frozen=True)
class SnakeFlight:
    """Of a batch of three."""

    off: torch.Tensor  # Joints from their commands after each step [rad], (T, 3, D)
    time: torch.Tensor  # [s], (T,)
    rate: torch.Tensor  # Of joints at the end [rad/s], (3, D)
    spin: float  # Of the first one about z at the end [rad/s]


def fly(name: str, *, hold: bool = True) -> SnakeFlight:
    """Return a flight in which the drives are told what holds and folds, or the rate 0."""
    robot = ROBOTS.get(name)
    hover = SnakeHover.from_robot(robot)
    env = simulation(robot, sim="base_sim_2ms", env="empty_env_2ms", num_envs=3, seed=1)
    env.reset()
    pose = hover.articulation.reference.float()
    shift = torch.zeros(3, len(pose))
    shift[1, 0::2], shift[2, 0::2] = FOLD, -FOLD
    thrusts = hover.equal_thrusts.float().expand(3, -1)
    seen, times = [], []
    for step in range(round(SECONDS / env.dt)):
        wanted = pose + shift * min(step * env.dt / RAMP, 1.0)
        joints = env.gtd["dof_position"], env.gtd["dof_velocity"]
        command = hover.drive_command(wanted, *joints).expand(3, -1) if hold else torch.zeros(3, len(pose))
        env.step(torch.cat((thrusts, command), dim=1))
        seen.append(wanted - env.gtd["dof_position"])
        times.append((step + 1) * env.dt)
    spin = float(env.gtd["robot_body_angvel"][0, 2])
    return SnakeFlight(torch.stack(seen), torch.tensor(times), env.gtd["dof_velocity"].clone(), spin)


@pytest.mark.parametrize("mode", ["position", "velocity", "effort"])
@pytest.mark.parametrize("rods", ["snakey", "snakey5", "snakey6"])
def test_a_snake_holds_its_shape_and_folds(rods: str, mode: str) -> None:
    name = rods if mode == "velocity" else f"{rods}_{mode}"
    flight, hover = fly(name), SnakeHover.from_robot(ROBOTS.get(name))
    rest = hover.rest(flight.spin).float()
    most = float(rest.abs().max())
    held, end = float(flight.off[:, 0].abs().max()), float(flight.off[-1].abs().max())
    folding = float(flight.off[flight.time < RAMP, 1:].abs().max())
    rate = float(flight.rate.abs().max())
    print(f"\n| `{name}` | {1e3 * held:.2f} | {1e3 * folding:.1f} | {1e3 * end:.2f} | {1e3 * most:.2f} | {rate:.0e} |")
    torch.testing.assert_close(-flight.off[-1, 0], rest, rtol=0.02, atol=ROUND_OFF)
    assert held < 2.0 * most
    running = FOLD / RAMP * torch.tensor([1.0, 0.0], dtype=F64).repeat(len(rest) // 2)
    behind = float(hover.lag(running, torch.linspace(0.0, RAMP, 201, dtype=F64)).max())
    assert folding == pytest.approx(behind, rel=0.1, abs=2.0 * most)
    assert end < 2.0 * most


@pytest.mark.parametrize("rods", ["snakey", "snakey5", "snakey6"])
def test_a_drive_told_to_stand_still_creeps_under_its_load(rods: str) -> None:
    """It is not stiff: ``S q'' + c q' = load`` from rest gives ``q = load t / c - S load / c²`` once the start has faded."""
    flight = fly(rods, hold=False)
    hover = SnakeHover.from_robot(ROBOTS.get(rods))
    load, inertia, _ = hover.on_joints(hover.articulation.reference, hover.equal_thrusts)
    row = round(0.5 / float(flight.time[0])) - 1
    expected = float(flight.time[row]) * load / DAMPING - inertia @ load / DAMPING**2
    torch.testing.assert_close(-flight.off[row, 0], expected.float(), rtol=0.05, atol=ROUND_OFF)


BENT = 0.02  # Angle [rad] beyond which no shape is held; the drives are at their limit from 0.006 rad on


def bending_time(name: str, dt: float, seconds: float = 5.0) -> float:
    """Return when a joint is off by more than ``BENT`` [s]; infinite where none is."""
    robot = ROBOTS.get(name)
    sim = replace(SIMS.get("base_sim_2ms"), dt=dt)
    env = simulation(robot, "lee_position_control", sim=sim, env="empty_env_2ms", seed=1)
    env.reset()
    pose = torch.tensor([joint.reference for joint in robot.joints.layout])
    actions = torch.zeros(2, 4 + len(pose))
    actions[:, :3] = env.gtd["robot_position"]
    actions[1, 0] += 0.5  # one stays, one goes on by half a metre
    actions[:, 4:] = pose if name.endswith("position") else 0.0
    for step in range(round(seconds / env.dt)):
        env.step(actions)
        if float((env.gtd["dof_position"] - pose).abs().max()) > BENT:
            return step * env.dt
    return float("inf")


@pytest.mark.parametrize("name", ["snakey_position", "snakey5_position"])
def test_four_and_five_rods_told_angles_keep_their_shape(name: str) -> None:
    assert bending_time(name, 2e-3) == float("inf")


@pytest.mark.parametrize("name", ["snakey6_position", "snakey", "snakey5", "snakey6"])
def test_six_rods_or_rates_do_not(name: str) -> None:
    coarse, fine = bending_time(name, 2e-3), bending_time(name, 1e-3)
    print(f"\n{name}: bent after {coarse:.2f} s in steps of 2 ms, {fine:.2f} s in steps of 1 ms")
    assert coarse < 5.0
    assert fine == pytest.approx(coarse, rel=0.1)
