"""Vehicles and states for tests: all parameters generic, nothing symmetric, float64."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch

from aerial_gym.config.learned_residual import LayerCfg, LearnedResidualCfg
from aerial_gym.config.robot import BatteryCfg, BodyCfg, CollisionCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg
from aerial_gym.math.quaternion import quat_normalize
from aerial_gym.physics import EFFECTS, BodyState, effects_from_config, state_at_rest
from aerial_gym.physics.effects import Effect, EffectParams
from aerial_gym.robots import ROBOTS

F64 = torch.float64

BATTERY = BatteryCfg(
    nominal_voltage=11.1, full_voltage=12.6, empty_voltage=10.5, internal_resistance=0.05, capacity=3600.0,
    efficiency=0.6, source="test",
)  # fmt: skip

SECOND_LOADS = {name for name in EFFECTS.names() if EFFECTS.get(name).in_place and EFFECTS.get(name).single}
ON_RIGID = tuple(name for name in EFFECTS.names() if EFFECTS.get(name).on_rigid and name not in SECOND_LOADS)
"""Every effect but those on links, which only a vehicle with joints has, and other laws of a load, of which it has one."""

CEILING = 9.0
"""Height for effects near a ceiling [m]; above random states lifted by 4 m."""


def asymmetric_robot(*, com: tuple[float, float, float] = (0.01, -0.02, 0.03)) -> RobotCfg:
    return RobotCfg(
        summary="test vehicle",
        body=BodyCfg(
            mass=0.8, inertia=((4.0e-3, 2.0e-4, -1.0e-4), (2.0e-4, 5.0e-3, 3.0e-4), (-1.0e-4, 3.0e-4, 7.0e-3)),
            com=com, source="test",
        ),
        rotor=RotorCfg(
            thrust_map=(0.0, 1e-4, 3e-6), torque_map=(0.0, 2e-6, 5e-8), time_constant_up=0.03,
            time_constant_down=0.05, thrust_range=(0.0, 8.0), radius=0.1, source="test",
        ),
        mounts=MountsCfg(
            layout=(
                MountCfg(position=(0.15, -0.14, 0.01), axis=(0.05, 0.02, 1.0), spin=1),
                MountCfg(position=(-0.16, -0.13, 0.02), axis=(-0.03, 0.04, 1.0), spin=-1),
                MountCfg(position=(-0.14, 0.15, 0.0), axis=(0.02, -0.05, 1.0), spin=1),
                MountCfg(position=(0.13, 0.16, -0.01), axis=(0.01, 0.03, 1.0), spin=-1),
            ),
            source="test",
        ),
        collision=CollisionCfg(source="test"), battery=BATTERY,
    )  # fmt: skip


def robot_with_memory() -> RobotCfg:
    """Return a quadrotor with drag, a battery and every effect that has memory, with one law of a load."""
    robot, effects = ROBOTS.get("tinyprop"), {"rotor_drag": {"dx": 0.3, "dy": 0.3, "dz": 0.3}}
    for name in (name for name in EFFECTS.names() if EFFECTS.get(name).remembers and name not in SECOND_LOADS):
        effect = EFFECTS.get(name)
        params = zip(effect.neutral(robot), effect.parameters, strict=True)
        steps = ((a, p, 0.5 * p.scale * (p.kind != "rotor")) for a, p in params)
        effects[name] = {p.name: min(a + step, p.high) for a, p, step in steps}
    return replace(robot, effects=effects, effects_source="test", battery=BATTERY)


def random_state(num_envs: int, *, seed: int = 0, rotor_speed: float = 800.0) -> BodyState:
    """Return random motion: metres, m/s and rad/s of order one, rotor speeds around ``rotor_speed``."""
    g = torch.Generator().manual_seed(seed)

    def normal(width: int) -> torch.Tensor:
        return torch.randn(num_envs, width, dtype=F64, generator=g)

    return BodyState(
        position=normal(3), attitude=quat_normalize(normal(4)), lin_vel=2.0 * normal(3), ang_vel=2.0 * normal(3),
        rotor_speed=rotor_speed * (1.0 + 0.1 * normal(4)),
    )  # fmt: skip


class SpeedControl:
    """The action is the rotor command."""

    action_names = ("first", "second", "third", "fourth")

    def rotor_command(self, state: BodyState, action: torch.Tensor) -> torch.Tensor:
        return action


def make_effects(values: dict[str, dict[str, float]], num_envs: int) -> list[tuple[Effect, torch.Tensor]]:
    return effects_from_config(values, num_envs=num_envs, device=torch.device("cpu"), dtype=F64)


def strong_effects(
    names: Iterable[str], robot: RobotCfg, num_envs: int, *, dtype: torch.dtype = F64, share: float = 1.0
) -> list[EffectParams]:
    """Return effects whose parameters are a share of their scales from neutral, each environment with rows of its own."""
    result = []
    for name in names:
        effect = EFFECTS.get(name).bind_robot(robot)
        row = [a + share * p.scale for a, p in zip(effect.neutral(robot), effect.parameters, strict=True)]
        result.append((effect, torch.tensor(row, dtype=dtype).repeat(num_envs, 1)))
    return result


def rest_state(num_envs: int = 1, **changes: list[float]) -> BodyState:
    """Return level bodies at rest with still rotors, but for what is given."""
    state = state_at_rest(num_envs, 4, device=torch.device("cpu"), dtype=F64)
    for name, row in changes.items():
        getattr(state, name)[:] = torch.tensor(row, dtype=F64)
    return state


def single(state: BodyState) -> BodyState:
    """Return the state in float32."""
    return BodyState(**{name: tensor.float() for name, tensor in vars(state).items()})


def random_network(*widths: int, seed: int = 0) -> LearnedResidualCfg:
    """Return a network with hidden layers of these widths, that trusts the states of ``random_state``. Outputs are some 0.3
    N and 0.02 N m; about every tenth is limited, as is every tenth input."""
    rng, sizes = np.random.default_rng(seed), (7, *widths)

    def rows(values: np.ndarray) -> tuple:
        return tuple(tuple(row) if values.ndim == 2 else row for row in values.tolist())

    hidden = tuple(
        LayerCfg(weights=rows(rng.normal(size=(high, low)) / low**0.5), bias=rows(0.3 * rng.normal(size=high)))
        for low, high in pairwise(sizes)
    )
    size = np.array([0.3] * 3 + [0.02] * 3)
    output = size[:, None] * rng.normal(size=(6, sizes[-1])) / (0.4 * sizes[-1]) ** 0.5
    return LearnedResidualCfg(
        low=(-3.3, -3.4, -3.2, -3.1, -3.5, -3.0, 5.0e5), high=(3.1, 3.2, 3.5, 3.4, 3.3, 3.6, 8.0e5),
        centre=(0.1, -0.2, 0.3, 0.05, -0.1, 0.15, 6.5e5), scale=(2.1, 1.9, 2.0, 2.2, 1.8, 2.0, 1.0e5),
        whitening=rows((np.eye(7) + 0.05 * rng.normal(size=(7, 7))) / 3.0), hidden=hidden,
        output=LayerCfg(weights=rows(output), bias=rows(0.1 * size)), limit=rows(1.5 * size), source="test",
    )  # fmt: skip
