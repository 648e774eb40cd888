"""Axial inflow: thrust falls in air from above and grows in air from below.

``dT = -ka w v_a`` for a rotor of speed w whose hub moves with v_a along its axis through the air; a roll rate changes the
thrust of both sides against it and so is damped. A reversed rotor has the opposite axis: both v_a and dT change sign, and
``|w|`` replaces w.
Source: Leishman (2006), Principles of Helicopter Aerodynamics, section 3.3 (blade element in axial flight): the angle of
attack falls by v_a / (w r), the lift by that times w²; Svacha, Mohta, Kumar (2017), Improving quadrotor trajectory
tracking by compensating for aerodynamic effects, eq. 6.
"""

from torch import Tensor

from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.rotor import RotorEffect
from aerial_gym.physics.effects.parameter import Parameter


class AxialInflow(RotorEffect):
    """Thrust against the velocity along the rotor axis."""

    name = "axial_inflow"
    summary = "thrust that falls with the velocity along the rotor axis"
    parameters = (Parameter("ka", "N s²/(m rad)", 0.0, 0.1, 1e-5, "thrust per speed and velocity"),)
    excitation = "climb and descent; roll and pitch rates tell it from a drag along z"
    confused_with = ("rotor_drag", "quadratic_drag", "thrust_coefficient")
    rotors = ("reversible", "slew", "dead_band")
    follows = ("velocity",)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``-ka |w| v_a``."""
        return -params[:, :1] * condition.rotor_speed.abs() * condition.axial_velocity
