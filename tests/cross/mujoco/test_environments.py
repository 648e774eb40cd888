"""Whole simulations and tasks on MuJoCo as a backend, beside those on torch. What a step computes in float32 differs by
its rounding, some 1e-7 a step, which a law that flies to a place does not let grow."""

import json
from dataclasses import replace

import pytest
import torch

from aerial_gym import SimBuilder, task_registry
from aerial_gym.assets import ENVIRONMENTS
from aerial_gym.cli.main import main
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.robots import ROBOTS

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

BODY = {"body.mass": RandomizeCfg(low=0.8, high=1.2), "body.inertia": RandomizeCfg(low=0.8, high=1.2)}


def build(backend: str, env="empty_env", **changes) -> EnvManager:
    options = {
        "sim_name": "base_sim", "robot_name": "base_quadrotor", "controller_name": "lee_position_control",
        "num_envs": 4, "device": "cpu", "seed": 3,
    }  # fmt: skip
    manager = SimBuilder().build_env(env_name=env, backend=backend, **options | changes)
    manager.reset()
    return manager


def assert_alike(one: EnvManager, other: EnvManager, *, bound: float = 1e-4) -> None:
    for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel"):
        torch.testing.assert_close(one.gtd[key], other.gtd[key], rtol=0.0, atol=bound, msg=key)


@pytest.mark.parametrize(
    "env", ["empty_env", pytest.param("env_with_obstacles", marks=pytest.mark.slow), "landing_env"]
)
def test_a_simulation_flies_as_on_torch(env: str) -> None:
    sims = [build(backend, env, randomize=BODY) for backend in ("torch", "mujoco")]
    masses = sims[1].gtd["robot_mass"].clone()
    assert masses.unique().numel() == 4
    for sim in sims:
        for _ in range(40):
            sim.step(torch.full((4, 4), 0.1))
    assert_alike(*sims)
    for sim in sims:
        sim.reset(torch.tensor([False, True, False, False]))
        for _ in range(40):
            sim.step(torch.full((4, 4), 0.1))
    assert_alike(*sims)
    assert (sims[1].gtd["robot_mass"] != masses).tolist() == [False, True, False, False]


def test_a_simulation_goes_on_from_what_was_kept_bit_for_bit() -> None:
    """Parameters of the body are among it, and they are written in place."""
    sim, other = build("mujoco", randomize=BODY), build("mujoco", randomize=BODY, seed=9)
    sim.step(torch.full((4, 4), 0.1))
    other.load_state({name: tensor.clone() for name, tensor in sim.state_tensors().items()})
    for each in (sim, other):
        for _ in range(5):
            each.step(torch.full((4, 4), 0.1))
    for key in ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel"):
        assert torch.equal(sim.gtd[key], other.gtd[key]), key


def put_down(backend: str) -> EnvManager:
    """Return robots with still rotors after 0.6 s on the ground of ``landing_env``, put down some millimetres above."""
    sim = build(backend, "landing_env", controller_name="no_control")
    for key, value in (("robot_linvel", 0.0), ("robot_body_angvel", 0.0), ("rotor_speed", 0.0)):
        sim.gtd[key].fill_(value)
    sim.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    sim.gtd["robot_position"][:, 2] = 0.184
    for _ in range(60):
        sim.step(torch.zeros(4, 4))
    return sim


WEIGHT = torch.tensor([[0.0, 0.0, 0.25 * 9.81]]).repeat(4, 1)
"""Of ``base_quadrotor`` [N]."""


def test_a_robot_at_rest_shows_its_weight_and_no_crash() -> None:
    sim = put_down("mujoco")
    torch.testing.assert_close(sim.gtd["robot_contact_force"], WEIGHT, rtol=1e-3, atol=1e-3)
    assert not sim.gtd["crashes"].any()


@pytest.mark.slow
def test_obstacles_push_by_the_hook_that_follows_each_substep() -> None:
    env = replace(ENVIRONMENTS.get("env_with_obstacles"), contact=ContactCfg(friction=0.2, crash_speed=5.0))
    forces = []
    for backend in ("torch", "mujoco"):
        sim = build(backend, env, controller_name="lee_velocity_control")
        largest = torch.zeros(4)
        for _ in range(150):
            sim.step(torch.tensor([[1.0, 0.5, 0.0, 0.0]]).repeat(4, 1))
            largest = largest.maximum(sim.gtd["robot_contact_force"].norm(dim=-1))
        forces.append(largest)
    assert (forces[1] > 0.1).any()
    assert ((forces[1] > 0.1) == (forces[0] > 0.1)).all()


@pytest.mark.parametrize("name", ["position_setpoint_task", pytest.param("navigation_task", marks=pytest.mark.slow)])
def test_a_task_steps_and_resets(name: str) -> None:
    rewards = []
    for backend in ("torch", "mujoco"):
        with task_registry.make_task(name, num_envs=4, device="cpu", seed=1, backend=backend) as task:
            task.reset()
            total = torch.zeros(4)
            for _ in range(20):
                _, reward, *_ = task.step(torch.zeros(4, task.num_actions))
                total += reward
        rewards.append(total)
    torch.testing.assert_close(rewards[1], rewards[0], rtol=1e-3, atol=1e-3)


def test_the_benchmark_prints_its_figure(capsys: pytest.CaptureFixture[str]) -> None:
    quick = ["--device", "cpu", "--repeats", "1", "--repeat-time-s", "0.02", "--threads", "1", "--num-envs", "8"]
    assert main(["bench", "physics", "--backend", "mujoco", "--json", *quick]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["backend"] == "mujoco"
    assert figures["versions"]["mujoco"]
    assert figures["steps_per_s"] > 0.0


def test_every_registered_rigid_robot_flies() -> None:
    """One step of each, as on torch: R from 1 to 8, rotors of every kind, vehicles under water."""
    for robot in (name for name in ROBOTS.names() if ROBOTS.get(name).joints is None):
        sims = [build(b, robot_name=robot, controller_name="no_control", num_envs=1) for b in ("torch", "mujoco")]
        for sim in sims:
            sim.step(sim.gtd["robot_actions"] * 0.0)
        assert_alike(*sims, bound=1e-5)
