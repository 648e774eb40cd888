"""Drag of rotors and body in air, per body axis. Letters: E environments."""

import torch
from torch import Tensor

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.math.rows import dot, length_of_vectors
from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import LinearWrenchEffect


class RotorDrag(LinearWrenchEffect):
    """Drag that grows linearly with speed: the induced drag of rotors and the blades' profile drag in sideways flow.

    ``F_i = -d_i v_i`` in body axes, at the centre of mass, with v the velocity through the air.
    Source: Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, section "induced drag"; Kai, Allibert, Hua, Hamel
    (2017), Nonlinear feedback control of quadrotors exploiting first-order drag effects, eq. 4.
    """

    name = "rotor_drag"
    summary = "force against the velocity through the air, linear in it, per body axis"
    parameters = tuple(Parameter(f"d{axis}", "N s/m", 0.0, 10.0, 0.1, f"drag along body {axis}") for axis in "xyz")
    excitation = "velocity along each body axis, in both directions or at several speeds"
    confused_with = ("quadratic_drag", "constant_wind", "com_offset")
    law = "drag linear in speed"
    rotors = ANY_ROTOR
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(v)`` for the force and zero for the torque, (E, 6, 3)."""
        force = -torch.diag_embed(condition.air_velocity)
        return torch.cat((force, torch.zeros_like(force)), dim=1)


class RotorDragOfThrust(RotorDrag):
    """Drag linear in speed as ``rotor_drag``, with an induced drag in the rotor plane that is proportional to the thrust.

    ``F = -(d + k T / m g (1, 1, 0)) v`` per body axis, with the sum T of the thrusts along body z; d + k acts in hover.
    Source: Omari, Hua, Ducard, Hamel (2013), Nonlinear control of VTOL UAVs incorporating flapping dynamics, section II.
    """

    name = "rotor_drag_of_thrust"
    summary = "force against the velocity through the air, linear in it, of which a part grows with the thrust"
    parameters = (*RotorDrag.parameters, Parameter("k", "N s/m", 0.0, 10.0, 0.1, "part in the rotor plane, in hover"))
    contains = ("rotor_drag",)
    law_of, law, in_place = "rotor_drag", "drag linear in speed and thrust", True
    on_joints = False  # The thrust in hover is that of the whole mass

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(v)`` and ``-T / m g (vx, vy, 0)`` for the force and zero for the torque, (E, 6, 4)."""
        alone = super().regressor(condition)
        thrust = dot(condition.rotor_thrust, condition.axis.unbind(-1)[2])
        share = (thrust / (condition.vehicle.mass * STANDARD_GRAVITY)).unsqueeze(-1)
        return torch.cat((alone, (share * (alone[..., 0] + alone[..., 1])).unsqueeze(-1)), dim=-1)


class QuadraticDrag(LinearWrenchEffect):
    """Drag of the body in the airstream, growing with the square of the speed.

    ``F_i = -d_i |v| v_i`` in body axes, at the centre of mass, with v the velocity through the air; for equal d_i this is
    the textbook ``0.5 rho C_D A |v|²`` against the motion.
    Source: Hoerner (1965), Fluid-Dynamic Drag, chapter 1, with one area per body axis.
    """

    name = "quadratic_drag"
    summary = "force against the velocity through the air, quadratic in speed, per body axis"
    parameters = tuple(Parameter(f"d{axis}", "N s²/m²", 0.0, 10.0, 0.05, f"drag along body {axis}") for axis in "xyz")
    excitation = "several different speeds through the air, some of them high, along each body axis"
    confused_with = ("rotor_drag", "constant_wind")
    law = "drag by the whole speed"
    rotors = ANY_ROTOR
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-|v| diag(v)`` for the force and zero for the torque, (E, 6, 3)."""
        v = condition.air_velocity
        force = -torch.diag_embed(length_of_vectors(v) * v)
        return torch.cat((force, torch.zeros_like(force)), dim=1)


class QuadraticDragOfAxes(QuadraticDrag):
    """Drag of the body by each component of the airspeed alone, as of plates across the axes.

    ``F_i = -d_i |v_i| v_i`` in body axes, at the centre of mass.
    Source: Fossen (2011), Handbook of Marine Craft Hydrodynamics and Motion Control, section 6.4.2.
    """

    name = "quadratic_drag_of_axes"
    summary = "force against each component of the velocity through the air, quadratic in it"
    law_of, law, in_place = "quadratic_drag", "drag by each component of the speed", True

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(|v_i| v_i)`` for the force and zero for the torque, (E, 6, 3)."""
        v = condition.air_velocity
        force = -torch.diag_embed(v.abs() * v)
        return torch.cat((force, torch.zeros_like(force)), dim=1)
