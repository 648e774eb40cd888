"""Effects on parameters of the whole vehicle: values that differ from the declared ones.

Letters: E environments.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter
from aerial_gym.physics.effects.kinds import VehicleEffect
from aerial_gym.physics.effects.rotor_failures import nominal_lag
from aerial_gym.physics.vehicle import Vehicle


class ThrustCoefficient(VehicleEffect):
    """Thrust coefficient: one factor on thrust and drag torque of all rotors, from air density, propellers or wear.

    ``T = k T_declared`` and ``q = k q_declared`` at every speed: both are proportional to the density of the air.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: thrust and torque coefficient.
    """

    name = "thrust_coefficient"
    summary = "one factor on thrust and drag torque of all rotors"
    acts_on = "rotor"
    parameters = (Parameter("scale", "-", 0.3, 3.0, 0.05, "true thrust per declared thrust", neutral=1.0),)
    excitation = "thrust, as any flight has; a wrong mass looks the same in the force and differs only in the torque"
    confused_with = ("payload_mass", "weak_motor", "battery_sag")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with scaled thrust and torque maps."""
        return vehicle.with_scaled_maps(thrust=params[:, :1], torque=params[:, :1])


class TorqueRatio(VehicleEffect):
    """Torque ratio: one factor on the drag torque of all rotors, at unchanged thrust.

    ``q = k q_declared`` at every speed.
    Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 2.2.5: torque coefficient.
    """

    name = "torque_ratio"
    summary = "one factor on the drag torque of all rotors"
    acts_on = "rotor"
    parameters = (Parameter("scale", "-", 0.1, 5.0, 0.1, "true drag torque per declared one", neutral=1.0),)
    excitation = "yaw accelerations that the rotors cause"
    confused_with = ("inertia_error", "motor_tilt", "rotor_inertia")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with a scaled torque map."""
        return vehicle.with_scaled_maps(torque=params[:, :1])


class ArmLength(VehicleEffect):
    """Arm length: one factor on the horizontal positions of all rotors.

    ``(x, y, z) -> (k x, k y, z)`` for every hub, in body axes.
    Source: Derived: the lever in ``tau = sum r x f``, e.g. Featherstone (2008), Rigid Body Dynamics Algorithms, section 2.15.
    """

    name = "arm_length"
    summary = "one factor on the horizontal distances of all rotors from the body origin"
    acts_on = "rotor"
    parameters = (Parameter("scale", "-", 0.3, 3.0, 0.05, "true per declared distance", neutral=1.0),)
    excitation = "roll and pitch accelerations; inertias that are wrong by one factor about both axes look the same"
    confused_with = ("inertia_error",)
    told_by_torques = True
    on_joints = False
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the rotors moved."""
        flat, height = vehicle.rotor_position.split((2, 1), dim=-1)
        return replace(
            vehicle, rotor_position=torch.cat((flat * params[:, None, :1], height.expand(len(flat), -1, -1)), -1)
        )


class TorqueGain(VehicleEffect):
    """Torque gain: factors on the torques of the rotors about the body axes, as of arms or propeller wash of other shape.

    Hubs ``(x, y, z) -> (sy x, sx y, z)`` and ``q -> sz q``. With thrusts along body z, torques about the origin become
    ``tau_i -> s_i tau_i``. Then ``w' = J^-1 (S tau - w x J w)``: where the gyroscopic term is below the noise, an inertia of
    ``1 / s_i`` times the declared one about that axis gives the same motion. With one s for all axes, it always does.
    Source: Derived: Euler's equation, e.g. Featherstone (2008), Rigid Body Dynamics Algorithms, section 2.15.
    """

    name = "torque_gain"
    summary = "factors on the torques of the rotors about each body axis"
    acts_on = "rotor"
    parameters = tuple(
        Parameter(f"s{axis}", "-", 0.1, 10.0, 0.1, f"true per declared torque, body {axis}", neutral=1.0)
        for axis in "xyz"
    )
    excitation = "turns about two axes at once, so fast that gyroscopic torques tell it from an inertia"
    confused_with = ("inertia_error", "arm_length", "torque_ratio")
    told_by_torques = True
    on_joints = False
    rotors = ANY_ROTOR
    by_default = False  # Inertia, arm length and torque ratio look the same

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the rotors moved and the torque map scaled."""
        x, y, z = vehicle.rotor_position.unbind(-1)
        place = torch.stack((params[:, 1:2] * x, params[:, :1] * y, z), dim=-1)
        return replace(vehicle.with_scaled_maps(torque=params[:, 2:3]), rotor_position=place)


class MotorTimeConstant(VehicleEffect):
    """Motor time constant: the true lag of the rotors, equal for rise and fall, in place of the declared one.

    ``tau dw/dt = w_command - w``. It acts between command and speed, so flights without commands cannot show it.
    Source: Pounds, Mahony, Corke (2010), Modelling and control of a large quadrotor robot, section 3.3.
    """

    name = "motor_time_constant"
    summary = "the true first-order lag of the rotor speeds, in place of the declared one"
    acts_on = "actuation"
    parameters = (Parameter("tau", "s", 1e-3, 1.0, 0.01, "time constant of rise and fall"),)
    excitation = "quick changes of the rotor commands"
    confused_with = ("motor_asymmetry", "actuation_delay", "battery_sag")
    rotors = ANY_ROTOR

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the mean of the declared rise and fall."""
        return (0.5 * sum(nominal_lag(robot)),)

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with both time constants replaced."""
        tau = params[:, :1].expand_as(vehicle.time_constant_up)
        return replace(vehicle, time_constant_up=tau, time_constant_down=tau)


class MotorAsymmetry(VehicleEffect):
    """Motor asymmetry: different lags of rising and falling rotor speeds, because drag alone brakes a rotor.

    ``tau_up dw/dt = w_command - w`` for a command above the speed, with ``tau_down`` for one below.
    Source: Foerster (2015), System identification of the Crazyflie 2.0, section 3.3, measures steps of both signs.
    """

    name = "motor_asymmetry"
    summary = "different first-order lags of rising and falling rotor speeds, in place of the declared ones"
    acts_on = "actuation"
    parameters = (
        Parameter("tau_up", "s", 1e-3, 1.0, 0.01, "time constant of rise"),
        Parameter("tau_down", "s", 1e-3, 1.0, 0.01, "time constant of fall"),
    )
    excitation = "quick changes of the rotor commands, up and down"
    contains = ("motor_time_constant",)
    confused_with = ("motor_time_constant", "actuation_delay", "battery_sag")
    rotors = ANY_ROTOR

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return the declared lags, as means over the rotors."""
        return nominal_lag(robot)

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with both time constants replaced."""
        up, down = (params[:, k : k + 1].expand_as(vehicle.time_constant_up) for k in (0, 1))
        return replace(vehicle, time_constant_up=up, time_constant_down=down)


class ComOffset(VehicleEffect):
    """Shifted centre of mass, with unchanged inertia about it.

    It changes the levers of the rotors, ``tau = sum (r - c) x f``, and the acceleration ``alpha x r + w x (w x r)`` of a
    body-fixed point at r from the centre of mass.
    Source: Derived: Newton-Euler equations about the centre of mass, e.g. Featherstone (2008), Rigid Body Dynamics
    Algorithms, section 2.15.
    """

    name = "com_offset"
    summary = "the centre of mass is shifted from its declared place"
    acts_on = "inertia"
    parameters = tuple(Parameter(axis, "m", -0.5, 0.5, 0.005, f"shift along body {axis}") for axis in "xyz")
    excitation = "x and y: any thrust; z: angular acceleration or rate together with the accelerometer"
    confused_with = ("weak_motor", "motor_tilt", "imu_bias")
    told_by_torques = True
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the shifted centre of mass."""
        return replace(vehicle, com=vehicle.com + params)


LEAST_SHARE = 0.4  # Least true mass, as a share of the declared mass


class PayloadMass(VehicleEffect):
    """Payload mass: additional or missing rigid mass at the centre of mass.

    ``m = m_declared + dm``; the inertia about the centre of mass stays as it is.
    Source: Derived: Newton's second law.
    """

    name = "payload_mass"
    summary = "mass that is not declared, at the centre of mass"
    acts_on = "inertia"
    parameters = (Parameter("dm", "kg", -10.0, 50.0, 0.02, "true minus declared mass"),)
    excitation = "thrust together with angular accelerations or drag: in hover alone a weaker thrust looks the same"
    confused_with = ("thrust_coefficient", "battery_sag", "weak_motor")
    rotors = ANY_ROTOR

    def bounds(self, robot: RobotCfg) -> list[tuple[float, float]]:
        """Return the bounds, with ``LEAST_SHARE`` of the declared mass as the least."""
        (most,) = self.parameters
        return [((LEAST_SHARE - 1.0) * robot.body.mass, most.high)]

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the mass added."""
        return replace(vehicle, mass=(vehicle.mass + params[:, 0]).maximum(LEAST_SHARE * vehicle.mass))


class InertiaError(VehicleEffect):
    """Inertia error: factors on the declared moments of inertia about the body axes.

    ``J' = S J S`` with the diagonal ``S = sqrt(s)``: moments of inertia scale by s, and J' stays positive definite.
    Source: Derived: a congruence keeps a matrix positive definite (Sylvester's law of inertia).
    """

    name = "inertia_error"
    summary = "moments of inertia that differ from the declared ones"
    acts_on = "inertia"
    parameters = tuple(
        Parameter(f"s{axis}", "-", 0.1, 10.0, 0.1, f"true per declared, body {axis}", neutral=1.0) for axis in "xyz"
    )
    excitation = "angular accelerations about each body axis"
    confused_with = ("torque_ratio", "thrust_coefficient", "rotor_inertia")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the inertia scaled."""
        stretch = params.sqrt()
        return replace(vehicle, inertia=stretch.unsqueeze(-1) * vehicle.inertia * stretch.unsqueeze(-2))


def add_products(inertia: Tensor, products: Tensor) -> Tensor:
    """Return an inertia (E, 3, 3) with products xy, xz, yz (E, 3) added, per root of the product of the two moments."""
    size = inertia.diagonal(dim1=-2, dim2=-1).sqrt()
    xy, xz, yz = products.unbind(-1)
    zero = torch.zeros_like(xy)
    share = torch.stack((zero, xy, xz, xy, zero, yz, xz, yz, zero), dim=-1).unflatten(-1, (3, 3))
    return inertia + size.unsqueeze(-1) * share * size.unsqueeze(-2)


class ProductsOfInertia(VehicleEffect):
    """Products of inertia: principal axes that are turned from the declared ones.

    ``J'_ij = J_ij + p_ij sqrt(J_ii J_jj)`` for i != j. Within the bounds a declared diagonal J stays positive definite.
    Source: Derived: unit diagonal and other entries p are positive definite if ``1 + 2 p_xy p_xz p_yz > sum p²``.
    """

    name = "products_of_inertia"
    summary = "principal axes of inertia that are turned from the declared ones"
    acts_on = "inertia"
    parameters = tuple(
        Parameter(pair, "-", -0.45, 0.45, 0.1, f"added J_{pair}, per sqrt(J_{pair[0] * 2} J_{pair[1] * 2})")
        for pair in ("xy", "xz", "yz")
    )
    excitation = "fast rotation about two axes, or torques about one axis while another one is still"
    confused_with = ("imu_misalignment", "motor_tilt", "com_offset", "inertia_error")
    rotors = ANY_ROTOR

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the products added."""
        return replace(vehicle, inertia=add_products(vehicle.inertia, params))
