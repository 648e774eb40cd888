"""Gusts: random wind with zero mean, an independent Ornstein-Uhlenbeck process on each axis.

``dw = -w dt / T + std sqrt(2 / T) dW``, with the variance std² and the autocorrelation ``exp(-|t| / T)``. Over a substep
``w' = a w + std sqrt(1 - a²) N(0, 1)``, ``a = exp(-dt / T)``: exact at the ends of substeps of any length; within a substep the
wind is constant. The first value after a reset is drawn from N(0, std²).
Source: Gillespie (1996), Exact numerical simulation of the Ornstein-Uhlenbeck process and its integral, eq. 1.9; as a model of
turbulence it is the longitudinal Dryden spectrum, MIL-F-8785C, section 3.7.
"""

import torch
from torch import Tensor

from aerial_gym.math.random import normal_draws
from aerial_gym.physics.effects.base import SubstepStart
from aerial_gym.physics.effects.kinds.wind import WindEffect
from aerial_gym.physics.effects.parameter import Parameter

SMALL = 0.01
"""Argument below which ``1 - exp(-x)`` comes from its series, exact in float32 (next term 4e-10 of it)."""


class Gusts(WindEffect):
    """Random wind."""

    name = "gusts"
    summary = "random wind with a correlation time; acts through the drag effects"
    parameters = (
        Parameter("std", "m/s", 0.0, 20.0, 1.0, "standard deviation of each axis"),
        Parameter("corr_time", "s", 0.01, 100.0, 1.0, "correlation time T", neutral=1.0),
    )
    excitation = "a known drag, and flights much longer than the correlation time"
    confused_with = ("constant_wind", "downwash")
    memory = (0.0, 0.0, 0.0)  # Wind [m/s], world
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the wind of this substep, (E, 3)."""
        share = moment.dt / values[:, 1:2]
        begins = (moment.since == 0).unsqueeze(-1)
        decay = torch.where(begins, 0.0, torch.exp(-share))
        spread = values[:, :1] * torch.where(begins, 1.0, (-torch.expm1(-2.0 * share)).sqrt())
        return decay * values[:, 2:] + spread * normal_draws(moment.random, 0, 3, dtype=values.dtype)

    def wind(self, position: Tensor, params: Tensor) -> Tensor:
        """Return the wind in memory, (E, 3)."""
        return params[:, 2:]
