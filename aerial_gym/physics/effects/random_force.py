"""Random force: uniform in a box along the world axes, drawn independently at regular intervals.

``F_i`` is uniform in -f_i to f_i, at the centre of mass, and constant for T. The velocity change within a time t of many
intervals has the standard deviation ``f_i sqrt(t T / 3) / m`` on each axis. A new interval begins at the first substep that
ends more than half a substep after the old one's end; T is at least a substep.
Source: Derived: the variance of a uniform draw is ``f² / 3``, and those of t / T independent impulses ``F T`` add up. As a
disturbance it is that of github learnsyslab/lsy_drone_racing (envs/race_core.py): 0.1 N, 500 times a second.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.math.random import uniform_draws
from aerial_gym.physics.effects.base import ANY_ROTOR, SubstepStart
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.wrench import WrenchEffect
from aerial_gym.physics.effects.parameter import Parameter

QUANTITY = 1
"""Index that separates its draws from those of ``gusts`` in the same substep."""


class RandomForce(WrenchEffect):
    """Random pushes."""

    name = "random_force"
    summary = "random force, uniform in a box, drawn anew at even intervals"
    parameters = (
        *(Parameter(axis, "N", 0.0, 100.0, 0.1, f"largest force along world {axis}") for axis in "xyz"),
        Parameter("hold", "s", 0.0001, 100.0, 0.002, "interval T between two draws", neutral=0.002),
    )
    excitation = "flights much longer than the interval"
    confused_with = ("gusts",)
    rotors = ANY_ROTOR
    memory = (0.0, 0.0, 0.0)  # Force [N], world
    random = True

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        """Return the force of this substep, (E, 3)."""
        share = moment.dt / values[:, 3]
        since = moment.since.to(values.dtype)
        begins = (moment.since == 0) | (((since + 0.5) * share).floor() > ((since - 0.5) * share).floor())
        drawn = values[:, :3] * (2.0 * uniform_draws(moment.random, 1, 3, dtype=values.dtype) - 1.0)
        return torch.where(begins.unsqueeze(-1), drawn, values[:, 4:])

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return the force in memory in body axes, without torque, (E, 6)."""
        force = quat_rotate_inverse(condition.attitude, params[:, 4:])
        return torch.cat((force, torch.zeros_like(force)), dim=-1)
