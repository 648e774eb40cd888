"""A steady, uniform wind.

Forces see the velocity through the air, ``v_air = v - wind``. Without any drag in the model a wind changes nothing.
Source: Derived: Galilean change of frame.
"""

from torch import Tensor

from aerial_gym.physics.effects.kinds.wind import WindEffect
from aerial_gym.physics.effects.parameter import Parameter


class ConstantWind(WindEffect):
    """Wind that is the same everywhere and always."""

    name = "constant_wind"
    summary = "steady uniform wind; acts through the drag effects"
    parameters = tuple(
        Parameter(axis, "m/s", -40.0, 40.0, 1.0, f"velocity of the air along world {axis}") for axis in "xyz"
    )
    excitation = (
        "a known drag, and headings or attitudes that differ (else a tilted or biased accelerometer looks alike)"
    )
    confused_with = ("rotor_drag", "quadratic_drag", "imu_bias", "com_offset")

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the parameters: the same wind at every position."""
        return params
