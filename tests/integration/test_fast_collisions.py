"""Fast flights through thin obstacles, whole environment steps: every crossing between two poses is a crash, nothing
else is. Robots start at 20 m/s along x in still air; a step of 10 ms takes them 20 cm."""

from dataclasses import replace
from math import pi

import pytest
import torch

from aerial_gym import ROBOTS, SIMS, EnvManager
from aerial_gym.config.environment import AssetCfg, PartCfg, ShapeCfg
from aerial_gym.config.robot import RobotCfg
from tests.builders import simulation
from tests.unit.assets.managers import MIDDLE, box_environment

NUM_ENVS, SPEED, DT = 400, 20.0, 0.01
RACER = ROBOTS.get("crazyflie_21_brushless_racing")
HULL = 0.07  # Half the width of the racer's four spheres [m]

POLE = ShapeCfg(kind="cylinder", radius=0.01, height=4.0)
WALL = ShapeCfg(kind="box", size=(0.02, 4.0, 4.0))
OPENING = 0.4
BAR = ShapeCfg(kind="box", size=(0.02, 1.0, 0.1))
BARS = (((0.0, 0.0, 0.25), 0.0), ((0.0, 0.0, -0.25), 0.0), ((0.0, 0.25, 0.0), 0.5 * pi), ((0.0, -0.25, 0.0), 0.5 * pi))
PARTS = tuple(PartCfg(shape=BAR, position=position, euler=(turn, 0.0, 0.0)) for position, turn in BARS)
GATE = ShapeCfg(kind="compound", parts=PARTS)


def build(shape: ShapeCfg | None, *, backend: str = "warp", robot: RobotCfg = RACER, **fields: object) -> EnvManager:
    """Return robots in rooms with one shape in the middle, level and with their rotors at rest."""
    assets = () if shape is None else (AssetCfg(name="obstacle", count=1, keep=True, shapes=(shape,), **MIDDLE),)
    sim = replace(SIMS.get("base_sim"), backend=backend, dt=DT)
    env = simulation(robot, sim=sim, env=box_environment((5.0, 5.0, 5.0), *assets, **fields), num_envs=NUM_ENVS, seed=1)
    env.reset()
    for key in ("robot_position", "robot_linvel", "robot_body_angvel", "rotor_speed"):
        env.gtd[key].zero_()
    env.gtd["robot_orientation"].copy_(torch.tensor([0.0, 0.0, 0.0, 1.0]))
    return env


def send_ahead(env: EnvManager) -> None:
    """Put the robots 0.1 to 0.3 m before the obstacle, one step's way, at 20 m/s."""
    share = (torch.arange(NUM_ENVS) + 0.5) / NUM_ENVS
    env.gtd["robot_position"][:, 0] = -0.1 - share * SPEED * DT
    env.gtd["robot_linvel"][:, 0] = SPEED


def crash_flags(env: EnvManager, steps: int) -> torch.Tensor:
    """Return the flags of robots that crash in some steps, (E,)."""
    result = torch.zeros(NUM_ENVS, dtype=torch.bool)
    for _ in range(steps):
        env.step(torch.zeros(NUM_ENVS, 4))
        result |= env.gtd["crashes"]
    return result


@pytest.mark.parametrize(("shape", "backend"), [(POLE, "warp"), (POLE, "torch"), (POLE, "mujoco"), (WALL, "warp")])
def test_no_start_ahead_of_a_thin_obstacle_flies_through_it(shape: ShapeCfg, backend: str) -> None:
    """The pole stands 2 cm beside the middle, in the way of one pair of rotors."""
    env = build(shape, backend=backend)
    send_ahead(env)
    env.gtd["robot_position"][:, 1] = 0.02
    crashed = crash_flags(env, 3)
    assert (env.gtd["robot_position"][:, 0] > 0.2).all()
    assert crashed.all()


def test_a_gate_is_open_as_far_as_it_is_wide() -> None:
    """Robots beside the middle by up to 0.3 m: those that fit between the posts pass, those within 1 mm of them may do
    either. The two spheres in a row are as high as they are wide, 0.07 m, so that the posts meet them at their full
    width."""
    env = build(GATE)
    send_ahead(env)
    beside = torch.linspace(-0.3, 0.3, NUM_ENVS)
    env.gtd["robot_position"][:, 1] = beside
    crashed = crash_flags(env, 3)
    room = 0.5 * OPENING - HULL - beside.abs()
    assert not crashed[room > 1e-3].any()
    assert crashed[(room < -1e-3)].all()
    assert (room > 1e-3).sum() > 100


def test_a_robot_that_is_moved_is_not_swept_from_its_old_place() -> None:
    env = build(WALL)
    send_ahead(env)
    env.gtd["robot_position"][:, 0] = -1.0
    assert not crash_flags(env, 1).any()
    env.gtd["robot_position"][:, 0] = 1.0
    assert not crash_flags(env, 1).any()
    env.gtd["robot_position"][:, 0] = -1.0
    env.reset(place=lambda mask: env.gtd["robot_position"][:, 0].fill_(1.0))
    env.gtd["robot_linvel"].zero_()
    assert not crash_flags(env, 1).any()
