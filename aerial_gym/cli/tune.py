"""``aerial-gym robot tune``: gains of a robot from a bandwidth and a damping."""

import json
from dataclasses import dataclass
from math import pi
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class TuneCmd:
    """Say with which ``control:`` a robot meets a bandwidth and a damping, with its lag and dead time."""

    robot: Annotated[str, tyro.conf.Positional]
    """Registered robot, or robot file (.yaml); its effects motor_time_constant, motor_asymmetry and actuation_delay count."""

    attitude_hz: float  # Bandwidth of roll, pitch and yaw [1/s]: where the answer is 0.71 of what is wanted
    position_hz: float  # Bandwidth along x, y, z [1/s]
    damping: float = 0.8  # Damping ratio of both loops, 0.3 to 1
    dt_s: float = 0.01  # Time step of the control law [s]
    json: bool = False  # Print one JSON object instead of YAML

    def run(self) -> int:
        """Tune and print; return 0, or 1 if the sampled loop would not come to rest."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.robots.tune import tune_robot

        robot = robot_by_name(self.robot)
        tuning = tune_robot(
            robot, name=self.robot, attitude=2.0 * pi * self.attitude_hz,
            position=2.0 * pi * self.position_hz, damping=self.damping, dt=self.dt_s,
        )  # fmt: skip
        names = ("attitude_frequency", "attitude_damping", "position_frequency", "position_damping")
        rows = {name: [round(number, 6) for number in getattr(tuning.control, name)] for name in names}
        if self.json:
            loop = {"lag_s": tuning.lag, "delay_s": tuning.delay}
            print(json.dumps(rows | loop | {"yaw_limited": tuning.yaw_limited, "radius": tuning.radius}))
        else:
            yaw = "; yaw is slower than asked, as the rotors give no more torque" if tuning.yaw_limited else ""
            loop = f"# rotor lag {tuning.lag:.4g} s, dead time {tuning.delay:.4g} s"
            print(f"{loop}; spectral radius {tuning.radius:.6f}{yaw}")
            if robot.joints is not None:
                print(f"# {robot.joints.rigid_note('gains are those for a vehicle that does not bend')}")
            print("control:")
            print("\n".join(f"  {name}: {numbers}" for name, numbers in rows.items()))
            print(f'  source: "{tuning.control.source}"')
        return int(tuning.radius > 1.0)
