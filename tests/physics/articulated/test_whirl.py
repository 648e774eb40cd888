"""Fast turns of vehicles with drives: what turning takes is that of the rates half way through a step."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.control import CONTROLLERS
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.physics.articulated.joint_laws import Drive
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.trees import F64


def test_a_top_gains_what_the_method_gives() -> None:
    """A torque-free symmetric top turns its lateral rate by ``x = (Iz / Ix - 1) w_z dt`` a step.

    Half way rates make of it ``1 + x J + x² J² / 2``, whose norm is ``sqrt(1 + x⁴ / 4)``; rates at the start ``sqrt(1 + x²)``,
    7.1 of a hundred steps of 0.2 in place of 1.02. A joint about the axis, whose drive asks for nothing, has no part in it.
    """
    tree = Tree(joints=(Joint(parent=0, axis=(0.0, 0.0, 1.0)),), floating=True)
    inertia = torch.diag(torch.tensor([0.01, 0.01, 0.018], dtype=F64)).expand(1, 2, 3, 3)
    links = Links(mass=torch.ones(1, 2, dtype=F64), com=torch.zeros(1, 2, 3, dtype=F64), inertia=inertia)
    none = torch.zeros(1, 1, dtype=F64)
    drive = Drive(stiffness=none, damping=none, position=none, rate=none, effort=none, limit=none + 1.0)
    state = replace(TreeState.at_rest(1, 1, like=none), ang_vel=torch.tensor([[3.0, 4.0, 125.0]], dtype=F64))
    for _ in range(100):
        state = implicit_euler(tree, links, (), state, 2e-3, gravity=0.0, drive=drive)
    assert state.ang_vel[0, :2].norm().item() == pytest.approx(5.0 * (1.0 + 0.2**4 / 4.0) ** 50, rel=1e-9)
    assert state.ang_vel[0, 2].item() == pytest.approx(125.0, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_no_snake_is_lost_under_random_commands(backend: str) -> None:
    """Thrusts and efforts drawn anew every quarter of a second, none of which an episode ends: rates stay what they can be."""
    env = EnvManager(
        sim=replace(SIMS.get("base_sim_2ms"), backend=backend),
        env=ENVIRONMENTS.get("empty_env_2ms"),
        robot=ROBOTS.get("snakey_effort"),
        controller=CONTROLLERS.get("no_control"),
        num_envs=64,
        device=torch.device("cpu"),
        seed=0,
    )
    env.reset()
    generator = torch.Generator().manual_seed(0)
    rotors, joints = ROBOTS.get("snakey_effort").num_rotors, env.gtd["dof_position"].shape[1]
    for _ in range(10):
        thrusts, efforts = (torch.rand(64, size, generator=generator) for size in (rotors, joints))
        commands = torch.cat((15.0 * thrusts, 0.6 * efforts - 0.3), dim=1)
        for _ in range(round(0.25 / env.dt)):
            env.step(commands)
    assert env.gtd["robot_body_angvel"].norm(dim=1).max() < 500.0
    assert env.gtd["dof_velocity"].isfinite().all()
