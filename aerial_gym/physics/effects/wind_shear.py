"""Wind shear: a steady wind that grows with height, as over open land.

``wind(h) = (x, y, 0) (h / z_ref)^exponent`` with the height h of the centre of mass over world z = 0; none below it.
Source: Stull (1988), An Introduction to Boundary Layer Meteorology, section 9.7.5 (power law); 1/7 is usual.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.kinds.wind import WindEffect
from aerial_gym.physics.effects.parameter import Parameter


class WindShear(WindEffect):
    """Wind by height."""

    name = "wind_shear"
    summary = "steady wind that grows with height; acts through the drag effects"
    parameters = (
        Parameter("x", "m/s", -40.0, 40.0, 1.0, "along world x at z_ref"),
        Parameter("y", "m/s", -40.0, 40.0, 1.0, "along world y at z_ref"),
        Parameter("z_ref", "m", 0.1, 100.0, 1.0, "height of reference", neutral=2.0, kind="convention"),
        Parameter("exponent", "-", 0.01, 2.0, 0.2, "power of the height", neutral=1.0 / 7.0),
    )
    excitation = "a known drag, and heights that differ by a factor of two or more"
    confused_with = ("constant_wind", "rotor_drag", "imu_bias")
    contains = ("constant_wind",)
    needs = ("position",)

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air, (E, 3)."""
        x, y, z_ref, exponent = params.unbind(-1)
        height = position[:, 2]
        above = height > 0.0
        relative = torch.where(above, height, z_ref) / z_ref
        gain = torch.where(above, torch.exp(exponent * torch.log(relative)), 0.0)
        return torch.stack((gain * x, gain * y, torch.zeros_like(gain)), dim=-1)
