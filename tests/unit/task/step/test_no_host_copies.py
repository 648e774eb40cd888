"""A step makes no tensor from Python's numbers: on a GPU that is a copy from the host, which no CUDA graph can hold."""

from dataclasses import replace
from typing import NoReturn

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.task_terms import ActionCfg
from aerial_gym.task import Task
from tests.builders import simulation

RANDOMIZE = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "body.inertia": RandomizeCfg(low=0.9, high=1.1),
    "rotor.thrust_map": RandomizeCfg(each_rotor=True, distribution="normal", mean=1.0, std=0.03, low=0.9, high=1.1),
    "effects.rotor_drag.dx": RandomizeCfg(how="value", low=0.0, high=0.2),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
}


EQUAL = ("motor_failure_task", "navigation_task")
DRAWN = ("position_setpoint_task", "racing_task")
"""Tasks of one kind each that are tried with drawn parameters as well."""


def kinds(randomize: dict, label: str, quick: tuple[str, ...]) -> list:
    """Return each task as a parameter, the others than the quick ones marked slow."""
    return [
        pytest.param(name, randomize, id=f"{name}-{label}", marks=() if name in quick else pytest.mark.slow)
        for name in task_registry.names()
    ]


@pytest.mark.parametrize(("name", "randomize"), kinds({}, "equal", EQUAL) + kinds(RANDOMIZE, "randomised", DRAWN))
def test_a_step_makes_no_tensor_of_numbers(name: str, randomize: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = replace(task_registry.get(name), num_envs=4)
    if cfg.robot == "snakey6":  # a sixth of its mass is in its base, which draws of the whole would use up
        randomize = {name: drawn for name, drawn in randomize.items() if not name.startswith("body.")}
    controller = "lee_velocity_control" if randomize else cfg.controller
    env = simulation(cfg.robot, controller, sim=cfg.sim, env=cfg.env, num_envs=4, randomize=randomize)
    tells_rotors = cfg.action.transform == "rotor_range" or "snakey" in cfg.robot
    fits = not randomize or not tells_rotors
    task = Task(replace(cfg, controller=controller, action=cfg.action if fits else ActionCfg()), env)
    task.reset()
    actions = torch.zeros(4, task.action_space.shape[0])
    task.step(actions)

    def refuse(*args: object, **options: object) -> NoReturn:
        raise AssertionError("a step copies numbers from the host")

    for each in ("tensor", "as_tensor", "from_numpy", "asarray"):
        monkeypatch.setattr(torch, each, refuse)
    for each in ("new_tensor", "item"):
        monkeypatch.setattr(torch.Tensor, each, refuse)
    for _ in range(2):
        task.env.gtd["sim_steps"].fill_(cfg.episode_len_steps)
        task.step(actions)
