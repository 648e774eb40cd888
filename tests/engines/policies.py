"""Policies for engines: what they observe and command, and their commands by torch, for comparison."""

from inspect import signature
from typing import NamedTuple

import torch
from torch import Tensor

from aerial_gym.export.agreement import Comparison
from aerial_gym.export.layout import Layout, ObservationTerm, layout_rotors
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.rl_training import Policy
from aerial_gym.robots import ROBOTS
from aerial_gym.task.terms.observations import OBSERVATIONS

STEPS = 10  # Steps of a flight, from reset


class States(NamedTuple):
    """States (B, ...) of a vehicle and its setpoint."""

    position: Tensor
    velocity: Tensor
    quaternion: Tensor  # xyzw, w >= 0
    ang_vel: Tensor
    target: Tensor
    target_velocity: Tensor

    def double(self) -> "States":
        return States(*(each.double() for each in self))


def random_states(rows: int) -> States:
    generator = torch.Generator().manual_seed(4)
    vectors = torch.randn(5, rows, 3, generator=generator)
    quaternion = torch.nn.functional.normalize(torch.randn(rows, 4, generator=generator))
    quaternion = torch.where(quaternion[:, 3:] < 0.0, -quaternion, quaternion)
    return States(vectors[0], vectors[1], quaternion, 3.0 * vectors[2], vectors[3], vectors[4])


def engine_layout(
    policy: Policy, terms: tuple[str, ...], *, kind: str = "thrust", robot: str = "crazyflie_21", rate_hz: float = 100.0,
    scale: float = 1.0,
) -> Layout:  # fmt: skip
    """Return the layout of a policy that observes some terms and commands the rotors of a quadrotor."""
    seen, first = [], 0
    for term in terms:
        count = OBSERVATIONS.get(term).width or 4 if term != "policy_action" else 4
        seen.append(
            ObservationTerm(
                key="observations", term=term, meaning=term, first=first, count=count, history=1, scale=scale,
                noise_std=0.0, delay_steps=(0, 0),
            )
        )  # fmt: skip
        first += count
    rotors = layout_rotors(ROBOTS.get(robot))
    low, high = rotors[0].thrust_range
    if kind == "speed":
        c0, c1, c2 = rotors[0].thrust_map
        low, high = (((c1 * c1 + 4.0 * c2 * (thrust - c0)) ** 0.5 - c1) / (2.0 * c2) for thrust in (low, high))
    command = tuple(f"{kind} {i} [{'N' if kind == 'thrust' else 'rad/s'}]" for i in range(1, 5))
    params = {"low": (low,) * 4, "high": (high,) * 4}
    return Layout(
        name="hover", task="position_setpoint_task", robot=robot, controller="no_control", rate_hz=rate_hz,
        observation=tuple(seen), command=command, num_actions=4, transform="affine", params=params,
        action_delay_steps=(0, 0), filter_time_s=0.0, memory=policy.body.memory_size, source="nowhere", rotors=rotors,
        version="0",
    )  # fmt: skip


def observation(made: Layout, states: States, action: Tensor) -> Tensor:
    """Return the observation (B, O) of states by the terms of the tasks."""
    known = {
        "robot_position": states.position, "robot_linvel": states.velocity, "robot_orientation": states.quaternion,
        "robot_body_angvel": states.ang_vel, "target_position": states.target, "target_velocity": states.target_velocity,
        "robot_body_linvel": quat_rotate_inverse(states.quaternion, states.velocity),
    }  # fmt: skip
    parts = []
    for seen in made.observation:
        if seen.term == "policy_action":
            parts.append(action)
        else:
            term = OBSERVATIONS.get(seen.term)
            parts.append(term.value(*(known[name] for name in term.inputs or signature(term.value).parameters)))
    return torch.cat(parts, dim=-1)


@torch.no_grad()
def commands(policy: Policy, made: Layout, states: States) -> Tensor:
    """Return the commands (B, 4) of flights of ``STEPS`` rows, in the float type of the states."""
    flown = DeployablePolicy(policy, made).eval().to(states.position.dtype)
    flights = len(states.position) // STEPS
    action = states.position.new_zeros(flights, 4)
    memory = (states.position.new_zeros(flights, made.memory),) if made.memory else ()
    results = []
    for step in range(STEPS):
        now = States(*(each[step::STEPS] for each in states))
        command, action, *memory = flown(observation(made, now, action), *memory)
        results.append(command)
    return torch.stack(results, dim=1).flatten(0, 1)


def compare(names: tuple[str, ...], exact: Tensor, rounded: Tensor, exported: Tensor) -> Comparison:
    result = Comparison(names)
    result.add(exact, rounded, exported)
    return result
