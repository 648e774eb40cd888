"""A vehicle with rotors of three types, one of them reversible and one in force mode, for tests."""

from dataclasses import replace

from aerial_gym.config.robot import MountCfg, MountsCfg, RobotCfg, RotorCfg
from tests.physics.vehicles import asymmetric_robot

PLAIN = RotorCfg(
    thrust_map=(0.02, 1e-4, 3e-6), torque_map=(1e-4, 2e-6, 5e-8), time_constant_up=0.03, time_constant_down=0.05,
    thrust_range=(0.05, 8.0), radius=0.1, source="test",
)  # fmt: skip

REVERSIBLE = RotorCfg(
    thrust_map=(0.0, 0.0, 3e-6), torque_ratio=0.015, reverse_thrust_map=(0.0, 1e-4, 2e-6), time_constant_up=0.03,
    time_constant_down=0.05, thrust_range=(-5.0, 8.0), slew_rate=2e4, dead_band=60.0, radius=0.1, source="test",
)  # fmt: skip

FORCE = RotorCfg(
    mode="force", torque_ratio=0.02, time_constant_up=0.02, time_constant_down=0.005, thrust_range=(-4.0, 6.0),
    slew_rate=60.0, slew_rate_down=90.0, radius=0.1, source="test",
)  # fmt: skip


def with_rotor(robot: RobotCfg, rotor: RotorCfg) -> RobotCfg:
    return replace(robot, rotor=rotor)


def three_type_robot() -> RobotCfg:
    robot = asymmetric_robot()
    names = ("reversible", "plain", "force", "reversible")
    layout: tuple[MountCfg, ...] = tuple(
        replace(mount, rotor=name) for mount, name in zip(robot.mounts.layout, names, strict=True)
    )
    rotors = {"plain": PLAIN, "reversible": REVERSIBLE, "force": FORCE}
    return replace(robot, rotor=None, rotors=rotors, mounts=MountsCfg(layout=layout, source="test"))
