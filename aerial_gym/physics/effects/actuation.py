"""Effects between commands and rotors: dead time, battery voltage, and the command curve with an idle speed and an exponent.

Command curve: ``w = w_r (offset + gain (c / w_r)^power)``, at least 0, with command c and reference w_r. A command of 0 stops
the rotor. Source: Derived: the curves of firmwares, such as THR_MDL_FAC of PX4 and thrust_linear of Betaflight, lie between
lines and powers of 1/2 and 2; a least speed (idle) is an offset.
Letters: E environments.
"""

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.physics.effects.base import ANY_ROTOR, Effect, Parameter, RotorSpeedsOfFlight, SubstepStart
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import CommandEffect, DelayEffect, RotorEffect
from aerial_gym.physics.rotors import rotor_torque
from aerial_gym.physics.vehicle import Vehicle, rotor_state_for_thrust

LONGEST = 0.1  # Largest delay [s]; the backend stores the commands of this span (51 at substeps of 2 ms)


class ActuationDelay(DelayEffect):
    """Dead time between commands and rotors, caused by radio, bus and electronic speed controllers.

    The rotors follow ``w_c(t - delay)``, with a constant command over each substep. If the delay is no multiple of the
    substep, the delayed command changes within a substep, and the lag follows one command, then the other. Speeds (in force
    mode thrusts) of either sign are exact at the stages and ends of substeps for every delay and division into substeps.
    The rotors keep their states until the first command after a reset arrives.
    Source: Derived: transport delay of a piecewise constant signal; in multirotors e.g. Foerster (2015), System
    identification of the Crazyflie 2.0, section 3.2.
    """

    name = "actuation_delay"
    summary = "dead time between the commands and the rotors"
    parameters = (Parameter("delay", "s", 0.0, LONGEST, 0.01, "dead time"),)
    excitation = "quick changes of the rotor commands, best with measured rotor speeds"
    confused_with = ("motor_time_constant", "motor_asymmetry")
    rotors = ANY_ROTOR
    longest = LONGEST

    def delay(self, params: Tensor) -> Tensor:
        """Return the delay [s], (E,)."""
        return params[:, 0]


LEAST_SQUARE = 1e-6  # Least discriminant over E² beyond the largest power, for a finite slope of the root


def speed_factor(voltage: Tensor, nominal: Tensor, gain: Tensor) -> Tensor:
    """Return the ratio of reached to commanded speed, ``1 - gain (1 - V / V_nominal)``, at least 0."""
    return (1.0 - gain * (1.0 - voltage / nominal)).clamp_min(0.0)


def voltage_under_load(open_voltage: Tensor, resistance: Tensor, power: Tensor) -> Tensor:
    """Return the voltage [V] of a battery at a power [W]: the larger root of ``V (E - V) / r = P``."""
    square = open_voltage.square()
    root = (square - 4.0 * resistance * power).maximum(LEAST_SQUARE * square).sqrt()
    return 0.5 * (open_voltage + root)


class BatteryEffect(Effect):
    """An effect of the battery voltage: logged in a flight, by charge and load in the simulator (``BatterySag``)."""

    memory = (0.0, 0.0)  # Charge drawn [A s] and voltage [V]; the latter is written before it is first read
    drifting = (0,)
    logged = ("battery",)
    follows = ("voltage",)

    def check(self, robot: RobotCfg) -> None:
        """Raise ``ConfigError`` unless the battery is known."""
        if robot.battery is None:
            raise ConfigError(
                f"effect {self.name}: the robot file must give battery: {{nominal_voltage, full_voltage, empty_voltage, "
                "internal_resistance, capacity, source}"
            )

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return charge at the end and voltage at the start of the substep, (E, 2)."""
        vehicle, charge, speed = moment.vehicle, values[:, 1], moment.rotor_speed
        _, full, empty, resistance, capacity, efficiency = vehicle.battery.unbind(-1)
        power = (rotor_torque(vehicle, speed) * speed).sum(-1) / efficiency
        open_voltage = full - (full - empty) * (charge / capacity).clamp_max(1.0)
        voltage = voltage_under_load(open_voltage, resistance, power)
        return torch.stack((charge + moment.dt * power / voltage, voltage), dim=-1)

    def memory_from_voltage(self, voltage: Tensor) -> Tensor:
        """Return no charge and the voltage, (T, 2)."""
        return torch.stack((torch.zeros_like(voltage), voltage), dim=-1)


class BatterySag(BatteryEffect, CommandEffect):
    """Battery sag: voltage falls under load, and with it the rotor speed per command.

    A command gives the speed ``w = w_c (1 - gain (1 - V / V_nominal))``: gain 0 is a controller that compensates the
    voltage, 1 a motor with speed proportional to it. In a flight V is measured. In the simulator it follows from the load
    at the start of each substep: with the mechanical power P of the rotors and the charge q drawn so far, ``V = E(q) - r
    I``, ``V I = P / efficiency``, ``dq/dt = I``, with an open-circuit voltage E that falls linearly from full to empty.
    Beyond the largest power of the battery, ``E² / 4 r``, V = E / 2.
    Source: Derived: Kirchhoff's voltage law, e.g. Tremblay, Dessaint (2009), Experimental validation of a battery dynamic
    model for EV applications, section 2, without polarisation; speed of a DC motor: Drela (2007), First-order DC electric
    motor model.
    """

    name = "battery_sag"
    summary = "rotor speeds that fall with the voltage of the battery"
    parameters = (Parameter("gain", "-", 0.0, 2.0, 0.2, "relative speed per relative voltage"),)
    excitation = "a long flight, or hard and gentle thrust, with the voltage and commands in the log"
    confused_with = ("thrust_coefficient", "payload_mass", "motor_time_constant")
    rotors = ("reversible", "slew", "dead_band")

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commanded speeds times the factor."""
        return command * speed_factor(params[:, 2], vehicle.battery[:, 0], params[:, 0]).unsqueeze(-1)


LEAST_VOLTAGE = 0.01  # Least voltage per nominal voltage in the power law


class ThrustVoltage(BatteryEffect, RotorEffect):
    """Thrust at a rotor speed that follows the battery voltage, as speeds that are logged or controlled wrongly do.

    ``T' = T (V / V_nominal)^k`` with the voltage V of ``battery_sag``. A sag of the speed is in measured rotor speeds
    already; this law is for what they leave.
    Source: Derived: a power law through the thrust at nominal voltage.
    """

    name = "thrust_voltage"
    summary = "thrust at a rotor speed that follows the battery voltage"
    parameters = (Parameter("k", "-", -3.0, 3.0, 0.2, "exponent of the voltage"),)
    excitation = "a long flight, or hard and gentle thrust, with the voltage and measured rotor speeds in the log"
    confused_with = ("thrust_coefficient", "battery_sag", "thrust_curve", "payload_mass")
    told_by_rotor_speeds = True
    rotors = ANY_ROTOR

    def replay(self, track: RotorSpeedsOfFlight, params: Tensor) -> Tensor:
        """Return no charge and the logged voltage in every row, (T, 2)."""
        if track.voltage is None:
            raise DataError(f"effect {self.name}: a flight without battery voltage; log it in volts (column vbat)")
        return self.memory_from_voltage(track.voltage)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``T ((V / V_nominal)^k - 1)``."""
        share = (params[:, 2:3] / condition.vehicle.battery[:, :1]).clamp_min(LEAST_VOLTAGE)
        return condition.rotor_thrust * (share ** params[:, :1] - 1.0)


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
