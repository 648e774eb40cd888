"""Vehicles and states for tests: all parameters generic, nothing symmetric, float64."""

import torch

from aerial_gym.config.robot import BatteryCfg, BodyCfg, CollisionCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg
from aerial_gym.math.quaternion import quat_normalize
from aerial_gym.physics import BodyState

F64 = torch.float64

BATTERY = BatteryCfg(
    nominal_voltage=11.1,
    full_voltage=12.6,
    empty_voltage=10.5,
    internal_resistance=0.05,
    capacity=3600.0,
    efficiency=0.6,
    source="test",
)

CEILING = 9.0
"""Height for effects near a ceiling [m]; above random states lifted by 4 m."""


def lopsided_robot(*, com: tuple[float, float, float] = (0.01, -0.02, 0.03)) -> RobotCfg:
    """Return a quadrotor with products of inertia, tilted rotors and an offset centre of mass."""
    return RobotCfg(
        summary="test vehicle",
        body=BodyCfg(
            mass=0.8,
            inertia=((4.0e-3, 2.0e-4, -1.0e-4), (2.0e-4, 5.0e-3, 3.0e-4), (-1.0e-4, 3.0e-4, 7.0e-3)),
            com=com,
            source="test",
        ),
        rotor=RotorCfg(
            thrust_map=(0.0, 1e-4, 3e-6),
            torque_map=(0.0, 2e-6, 5e-8),
            time_constant_up=0.03,
            time_constant_down=0.05,
            thrust_range=(0.0, 8.0),
            radius=0.1,
            source="test",
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
        collision=CollisionCfg(source="test"),
        battery=BATTERY,
    )


def random_state(num_envs: int, *, seed: int = 0, rotor_speed: float = 800.0) -> BodyState:
    """Return random motion: metres, m/s and rad/s of order one, rotor speeds around ``rotor_speed``."""
    g = torch.Generator().manual_seed(seed)

    def normal(width: int) -> torch.Tensor:
        return torch.randn(num_envs, width, dtype=F64, generator=g)

    return BodyState(
        position=normal(3),
        attitude=quat_normalize(normal(4)),
        lin_vel=2.0 * normal(3),
        ang_vel=2.0 * normal(3),
        rotor_speed=rotor_speed * (1.0 + 0.1 * normal(4)),
    )
