"""Rotor speed scale: a factor on logged rotor speeds, from a wrong number of magnet poles or marks, or a wrong unit.

``w_measured = k w``; the flight itself is unchanged.
Source: Derived: a tachometer counts k times as many events per turn as assumed.
"""

from torch import Tensor

from aerial_gym.physics.effects.kinds.sensor import RotorSensorEffect
from aerial_gym.physics.effects.parameter import Parameter


class RotorSpeedScale(RotorSensorEffect):
    """A factor on measured rotor speeds."""

    name = "rotor_speed_scale"
    summary = "measured rotor speeds that are off by a factor"
    parameters = (Parameter("scale", "-", 0.05, 20.0, 0.05, "measured per true speed", neutral=1.0),)
    excitation = "measured speeds beside commands; without commands a thrust coefficient looks the same"
    confused_with = ("thrust_coefficient", "battery_sag")
    rotors = ("reversible", "slew", "dead_band")

    def measure(self, rotor_speed: Tensor, params: Tensor) -> Tensor:
        """Return ``k w``."""
        return params[:, :1] * rotor_speed

    def true_speed(self, measured: Tensor, params: Tensor) -> Tensor:
        """Return ``w_measured / k``."""
        return measured / params[:, :1]
