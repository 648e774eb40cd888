"""Wind shear: a steady wind that grows with height, as over open land.

``wind(h) = (x, y, 0) (h / z_ref)^exponent`` with the height h of the centre of mass over world z = 0; none below it.
Source: Stull (1988), An Introduction to Boundary Layer Meteorology, section 9.7.5 (power law); 1/7 is usual.
"""

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.effects.kinds.wind import WindEffect
from aerial_gym.physics.effects.parameter import Parameter


class WindShear(WindEffect):
    """Wind by height."""

    name = "wind_shear"
    summary = "steady wind that grows with height; acts through the drag effects"
    parameters = (
        Parameter(name="x", unit="m/s", low=-40.0, high=40.0, scale=1.0, meaning="along world x at z_ref"),
        Parameter(name="y", unit="m/s", low=-40.0, high=40.0, scale=1.0, meaning="along world y at z_ref"),
        Parameter(
            name="z_ref", unit="m", low=0.1, high=100.0, scale=1.0, meaning="height of reference", kind="convention"
        ),
        Parameter(name="exponent", unit="-", low=0.01, high=2.0, scale=0.2, meaning="power of the height"),
    )
    excitation = "a known drag, and heights that differ by a factor of two or more"
    confused_with = ("constant_wind", "rotor_drag", "imu_bias")
    contains = ("constant_wind",)
    needs = ("position",)

    def neutral(self, robot: RobotCfg) -> tuple[float, ...]:
        """Return no wind at 2 m, which would grow by the power 1/7."""
        return 0.0, 0.0, 2.0, 1.0 / 7.0

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the velocity of the air, (E, 3)."""
        x, y, z_ref, exponent = params.unbind(-1)
        height = position[:, 2]
        above = height > 0.0
        relative = torch.where(above, height, z_ref) / z_ref
        gain = torch.where(above, torch.exp(exponent * torch.log(relative)), 0.0)
        return torch.stack((gain * x, gain * y, torch.zeros_like(gain)), dim=-1)
