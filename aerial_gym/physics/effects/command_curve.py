"""Command curve: the rotor speed that a command reaches, with an idle speed and an exponent.

``w = w_r (offset + gain (c / w_r)^power)``, at least 0, with command c and reference w_r. A command of 0 stops the rotor.
Source: Derived: the curves of firmwares, such as THR_MDL_FAC of PX4 and thrust_linear of Betaflight, lie between lines and
powers of 1/2 and 2; a least speed (idle) is an offset.
"""

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.kinds import CommandEffect
from aerial_gym.physics.vehicle import Vehicle, rotor_state_for_thrust


class CommandCurveEffect(CommandEffect):
    """A curve between commanded and reached rotor speeds."""

    name = "command_curve"
    summary = "rotor speeds that follow commands by another curve: idle speed, range, exponent"
    parameters = (
        Parameter(name="offset", unit="-", low=-2.0, high=2.0, scale=0.05, meaning="speed at no command, per reference"),
        Parameter(name="gain", unit="-", low=0.1, high=10.0, scale=0.05, meaning="further speed at the reference, per it"),
        Parameter(name="power", unit="-", low=0.2, high=5.0, scale=0.1, meaning="exponent of the command"),
        Parameter(
            name="reference", unit="rad/s", low=1e-3, high=1e6, scale=100.0, kind="convention",
            meaning="speed, in force mode thrust, to which the curve refers; the declared one at hover",
        ),
    )  # fmt: skip
    excitation = "commands over a wide range beside measured rotor speeds"
    confused_with = ("rotor_speed_scale", "battery_sag", "motor_asymmetry", "thrust_coefficient")
    told_by_rotor_speeds = True
    rotors = ("force", "slew", "dead_band")
    memory = (0.0,)  # Not used: backends apply effects on commands with the memory of a substep

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the line through the origin, with the mean declared state at hover as reference."""
        share = robot.body.mass * STANDARD_GRAVITY / robot.num_rotors
        states = [rotor_state_for_thrust(rotor, share) for rotor in robot.rotor_types]
        return 0.0, 1.0, 1.0, float(sum(states)) / robot.num_rotors

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the speeds of the curve."""
        del vehicle
        offset, gain, power, reference = (params[:, k : k + 1] for k in range(4))
        share = (command / reference).clamp_min(1e-6)
        target = reference * (offset + gain * share**power).clamp_min(0.0)
        return torch.where(command > 0.0, target, command)

    def memory_from_voltage(self, voltage: Tensor) -> Tensor:
        """Return zeros, (T, 1): the curve remembers nothing."""
        return torch.zeros_like(voltage).unsqueeze(-1)
