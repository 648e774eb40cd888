"""Effects on one rotor, and failures that begin at a given time.

Letters: E environments, R rotors.
"""

from dataclasses import replace
from statistics import fmean

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter, SubstepStart
from aerial_gym.physics.effects.kinds import CommandEffect, VehicleEffect
from aerial_gym.physics.vehicle import Vehicle

MOST_ROTORS = 64

ROTOR = Parameter("motor", "-", 1, MOST_ROTORS, 1.0, "which rotor, from 1 on", neutral=1.0, kind="rotor")


def nominal_lag(robot: RobotCfg) -> tuple[float, float]:
    """Return the declared time constants of rise and fall [s], as means over the rotors."""
    rotors = robot.rotor_types
    return fmean(rotor.time_constant_up for rotor in rotors), fmean(rotor.time_constant_down for rotor in rotors)


def rotor_mask(vehicle: Vehicle, motor: Tensor) -> Tensor:
    """Return a mask (E, R) with 1 at the rotor of number ``motor`` (E,), counted from 1, and 0 elsewhere."""
    numbers = torch.arange(1, vehicle.num_rotors + 1, device=motor.device)
    return (numbers == motor.round().unsqueeze(1)).to(vehicle.rotor_spin.dtype)


LATEST = 1e5  # Largest start time [s]
NEVER = 1e4  # Start time beyond every episode [s]
TIME = Parameter("time", "s", 0.0, LATEST, 0.1, "from the reset to the failure", kind="convention")


def substep_middle(moment: SubstepStart, like: Tensor) -> Tensor:
    """Return the middle of the coming substep [s], (E,), because failures begin at the boundary nearest to their time."""
    return (moment.since.to(like.dtype) + 0.5) * moment.dt


class WeakMotor(VehicleEffect):
    """Weak motor: one rotor gives less, or more, thrust than declared at the same speed, as with a chipped or wrong propeller.

    ``T = k T_declared`` and ``q = k q_declared`` for that rotor: a blade that has lost area loses lift and drag with it.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: both coefficients grow with the blade
    area.
    """

    name = "weak_motor"
    summary = "one rotor gives less thrust and drag torque than declared"
    acts_on = "rotor"
    parameters = (ROTOR, Parameter("scale", "-", 0.1, 2.0, 0.05, "true thrust per declared thrust", neutral=1.0))
    excitation = "thrust that varies, and yaw: in hover alone a shifted centre of mass looks the same"
    confused_with = ("com_offset", "thrust_coefficient", "motor_tilt", "payload_mass", "tachometer_scale")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the maps of one rotor scaled."""
        factor = 1.0 + rotor_mask(vehicle, params[:, 0]) * (params[:, 1:] - 1.0)
        return vehicle.with_scaled_maps(thrust=factor, torque=factor)


class MotorGain(CommandEffect):
    """Motor gain: one rotor reaches another speed than its command, as with a speed controller of other calibration.

    ``w_reached = k w_command`` for that rotor, with its own lag; in force mode its thrust.
    Source: Derived: a proportional error between a command and the speed that it requests.
    """

    name = "motor_gain"
    summary = "one rotor reaches another speed than commanded"
    parameters = (ROTOR, Parameter("scale", "-", 0.1, 2.0, 0.03, "reached speed per command", neutral=1.0))
    excitation = "commands beside measured rotor speeds; without these a weak motor looks the same"
    confused_with = ("weak_motor", "tachometer_scale", "command_curve")
    told_by_rotor_speeds = True
    rotors = ANY_ROTOR
    memory = (0.0,)  # Not used: backends apply effects on commands with the memory of a substep

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with that of one rotor times k."""
        return command * (1.0 + rotor_mask(vehicle, params[:, 0]) * (params[:, 1:2] - 1.0))


class MotorTilt(VehicleEffect):
    """Motor tilt: the axis of one rotor differs from the declared one, as with a bent arm or a skewed mount.

    The axis a is rotated by a roll about body x, then by a pitch about body y: ``a' = R_y(pitch) R_x(roll) a``.
    Source: Derived: rotation of a vector, e.g. Siciliano et al. (2009), Robotics, section 2.2.
    """

    name = "motor_tilt"
    summary = "the axis of one rotor is turned from its declared direction"
    acts_on = "rotor"
    parameters = (
        ROTOR,
        Parameter("roll", "rad", -1.0, 1.0, 0.03, "turn about body x"),
        Parameter("pitch", "rad", -1.0, 1.0, 0.03, "then about body y"),
    )
    excitation = "thrust of that rotor that varies; yaw tells it from a shifted centre of mass"
    confused_with = ("com_offset", "weak_motor", "imu_misalignment", "torque_ratio")
    shown_by_forces = True  # Its sideways force follows the thrust of one rotor; a turned sensor's follows that of all
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with one axis rotated."""
        chosen = rotor_mask(vehicle, params[:, 0])
        roll, pitch = (chosen * params[:, k : k + 1] for k in (1, 2))
        x, y, z = vehicle.rotor_axis.unbind(-1)
        y, z = roll.cos() * y - roll.sin() * z, roll.sin() * y + roll.cos() * z
        x, z = pitch.cos() * x + pitch.sin() * z, pitch.cos() * z - pitch.sin() * x
        return replace(vehicle, rotor_axis=torch.stack((x, y, z), dim=-1))


class MotorFailure(CommandEffect):
    """Motor failure in flight: from a given time on, one rotor follows a part of its command, or stops.

    From the substep boundary nearest to ``time`` after the reset, the rotor approaches ``scale`` times the command, with
    its own lag; before, the command. Thrust and drag torque follow from the speed as usual: with a quadratic thrust map,
    ``scale²`` of the thrust remains.
    Source: loss of effectiveness of an actuator, e.g. Zhang, Jiang (2008), Bibliographical review on reconfigurable
    fault-tolerant control systems, section 2; with the lag it models a motor that runs down, not a broken propeller
    (``weak_motor``).
    """

    name = "motor_failure"
    summary = "from a given time on one rotor follows a part of its command, or stops"
    parameters = (
        ROTOR,
        Parameter("scale", "-", 0.0, 1.0, 0.3, "speed, in force mode thrust, per command, after it", neutral=1.0),
        TIME,
    )
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("weak_motor", "com_offset")
    rotors = ANY_ROTOR
    memory = (1.0,)  # Factor on the command of the rotor
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the factor of this substep, (E, 1)."""
        middle = substep_middle(moment, values)
        return torch.where(middle.unsqueeze(-1) < values[:, 2:3], 1.0, values[:, 1:2])

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with that of one rotor times the factor."""
        return command * (1.0 + rotor_mask(vehicle, params[:, 0]) * (params[:, 3:] - 1.0))


class StuckRotor(CommandEffect):
    """Stuck rotor: from a given time on, one rotor keeps its speed and ignores commands.

    From the substep boundary nearest to ``time`` after the reset, the rotor holds its present speed, in force mode its
    thrust, as a speed controller does without new commands.
    Source: lock in place, one of the failures of an actuator in Boskovic, Mehra (1999), Stable multiple model adaptive
    flight control for accommodation of a large class of control effector failures, American Control Conference.
    """

    name = "stuck_rotor"
    summary = "from a given time on one rotor keeps its speed"
    parameters = (ROTOR, replace(TIME, neutral=NEVER))
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("motor_failure",)
    rotors = ANY_ROTOR
    memory = (0.0, 0.0)  # Whether it is stuck, and at which speed
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the flag of a stuck rotor in this substep, and its speed, (E, 2)."""
        stuck = substep_middle(moment, values) >= values[:, 1]
        now = (rotor_mask(moment.vehicle, values[:, 0]) * moment.rotor_speed).sum(-1)
        kept = torch.where(values[:, 2] > 0.0, values[:, 3], now)
        return torch.stack((stuck.to(values.dtype), torch.where(stuck, kept, 0.0)), dim=-1)

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands with that of the stuck rotor replaced by its speed."""
        kept = rotor_mask(vehicle, params[:, 0]) * params[:, 2:3] > 0.0
        return torch.where(kept, params[:, 3:], command)


class BrownOut(CommandEffect):
    """Brown-out: a temporary loss of supply voltage, during which all motors reach a part of their commands, or none.

    It starts at the substep boundary nearest to ``time`` after the reset and lasts for ``duration``. All rotors then
    approach ``scale`` times the command, each with its own lag, and afterwards the command again. Causes are a loose
    contact, a failing battery, or a restart of speed controllers. ``battery_sag`` models charge and load of an intact
    battery.
    Source: motor speed proportional to voltage, as in ``battery_sag``: Drela (2007), First-order DC electric motor model.
    """

    name = "brown_out"
    summary = "for a while all rotors reach a part of their commands, or nothing"
    parameters = (
        Parameter("scale", "-", 0.0, 1.0, 0.3, "speed, in force mode thrust, per command, while it lasts", neutral=1.0),
        TIME,
        Parameter("duration", "s", 0.0, LATEST, 0.1, "until the supply recovers", kind="convention"),
    )
    excitation = "an episode that goes on after it; a log does not say when its reset was"
    confused_with = ("battery_sag", "thrust_coefficient")
    rotors = ANY_ROTOR
    memory = (1.0,)  # Factor on the commands
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the factor of this substep, (E, 1)."""
        since = substep_middle(moment, values).unsqueeze(-1) - values[:, 1:2]
        return torch.where((since >= 0.0) & (since < values[:, 2:3]), values[:, :1], 1.0)

    def command(self, command: Tensor, vehicle: Vehicle, params: Tensor) -> Tensor:
        """Return the commands times the factor."""
        return command * params[:, 3:]
