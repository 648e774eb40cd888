"""Policies that need no training, and what they fly."""

from dataclasses import replace
from functools import cache
from typing import Any

import torch

from aerial_gym import ENVIRONMENTS, Task, task_registry
from aerial_gym.config.task_terms import ActionCfg
from aerial_gym.export.layout import Layout, policy_layout
from aerial_gym.rl_training import Policy, TrainingCfg, load_settings, settings_for
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from tests.unit.task.hover import build_task

HOVER = task_registry.get("position_setpoint_task")

PLACES = {
    "low": [0.1, -2.0, 0.0, -1.0], "high": [2.0, 2.0, 1.0, 1.5], "speeds": [True, True, False, False],
    "mix": [[0.7, 0.2, 0.1, 0.3], [-0.4, 0.9, -0.3, 0.1], [0.5, -0.9, 0.2, 0.1], [0.3, 0.3, -0.8, -0.7]],
}  # fmt: skip
TRANSFORMS = {
    name: (ActionCfg(transform=transform, params=params), controller)
    for name, transform, params, controller in (
        ("direct", "direct", {}, "lee_attitude_control"),
        (
            "forward_flight", "forward_flight", {"max_speed": 2.0, "max_inclination": 0.7, "max_yaw_rate": 1.0},
            "lee_velocity_control",
        ),
        ("affine", "affine", {"low": [-1.0, -0.5, -3.0, 0.0], "high": [2.0, 0.5, 1.0, 0.25]}, "lee_attitude_control"),
        (
            "affine_in_another_order", "affine", {"low": [-1.0] * 4, "high": [2.0] * 4, "order": [2, 0, 3, 1]},
            "lee_attitude_control",
        ),
        ("four_places", "four_places", PLACES, "lee_attitude_control"),
    )
}  # fmt: skip
"""Each transform of actions, with a controller that takes what it gives."""


def training() -> TrainingCfg:
    return load_settings(settings_for("ppo", "position_setpoint_task"))


def random_policy(
    num_observations: int = 13, *, activation: str = "elu", memory: int = 0, normalize: bool = True,
    hidden_layers: tuple[int, ...] = (24, 17),
) -> Policy:  # fmt: skip
    generator = torch.Generator().manual_seed(3)
    kind = {"activation": activation, "memory": memory, "normalize": normalize, "hidden_layers": hidden_layers}
    policy = Policy(NetworkBodyCfg(shapes={"observations": (num_observations,)}, **kind), 4)
    for parameter in policy.parameters():
        parameter.data = 0.4 * torch.randn(parameter.shape, generator=generator)
    if normalize:
        normalizer = policy.body.normalizers["observations"]
        spread = torch.logspace(-1, 1, num_observations)
        normalizer.update(2.0 + spread * torch.randn(500, num_observations, generator=generator))
    return policy.requires_grad_(False).eval()


def hover_policy(*, memory: bool = False) -> Policy:
    """Return a position controller as a network: linear in position error, velocity and yaw, as ``relu(x) - relu(-x)``.
    Attitude commands (thrust - 1, roll, pitch, yaw rate) of 13 observations: error in the world, quaternion, velocity
    in the body, rates. Right near level and near heading 0, where the task begins. With a memory a gated recurrent unit
    takes the mean of what it remembers and ``tanh`` of a tenth of each of the eight, of which the head takes ten times
    as much: a low pass."""
    law = torch.zeros(4, 13)
    law[0, 2], law[0, 9] = 0.6, -0.5
    law[2, 0], law[2, 7] = 0.25, -0.3
    law[1, 1], law[1, 8] = -0.25, 0.3
    law[3, 5] = -2.0
    kind = {"activation": "relu", "normalize": False, "memory": 8 if memory else 0, "hidden_layers": (8,)}
    policy = Policy(NetworkBodyCfg(shapes={"observations": (13,)}, **kind), 4)
    (linear, _), head, cell = policy.body.layers, policy.head, policy.body.cell
    linear.weight.data, linear.bias.data = torch.cat((law, -law)), torch.zeros(8)
    head.weight.data, head.bias.data = torch.cat((torch.eye(4), -torch.eye(4)), dim=1), torch.zeros(4)
    if cell is not None:
        for weight in cell.parameters():
            weight.data.zero_()  # gates of zero are half open
        cell.weight_ih.data[16:] = 0.1 * torch.eye(8)
        head.weight.data *= 10.0
    return policy.requires_grad_(False).eval()


def hover(rate_hz: int, *, delay: int = 0, noise: float = 0.0, num_envs: int = 16) -> Task:
    """Return the position task at a rate on a simulation of 500 Hz, commands late by so many steps, all it sees noisy."""
    seen = tuple(replace(entry, noise_std=noise) for entry in HOVER.observations["policy"])
    action = ActionCfg(delay_steps=delay)
    cfg = replace(
        HOVER, observations={"policy": seen}, action=action, episode_len_steps=3 * rate_hz, sim="base_sim_2ms"
    )
    place = replace(ENVIRONMENTS.get("empty_env"), physics_steps_per_env_step=500 // rate_hz)
    return build_task(replace(cfg, env=place), num_envs, seed=5)


@cache
def _hover_layout() -> Layout:
    with build_task(HOVER, 1) as task:
        return policy_layout(random_policy(), training(), task, name="hover", source="nowhere")


def layout(policy: Policy) -> Layout:
    """Return the layout of a policy with the inputs and outputs of the hover task, which is built once."""
    return replace(_hover_layout(), memory=policy.body.memory_size)


def make_layout(policy: Policy, name: str, **params: Any) -> Layout:
    """Return the layout of a hover policy with one of ``TRANSFORMS``; ``params`` replace some of its numbers."""
    action, _ = TRANSFORMS[name]
    return replace(layout(policy), transform=action.transform, params={**action.params, **params})
