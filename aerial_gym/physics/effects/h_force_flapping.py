"""H-force and flapping: in sideways flow a rotor has an in-plane force against the motion, and a moment at its hub.

For a hub at l with velocity v through the air, its component ``v_e`` in the plane of a rotor of axis a and speed w gives
``F = -kh w v_e`` at the hub, and ``tau = l x F + kf w (v_e x a)``: in forward flight the disc tilts back, and lifts the nose.
Source: Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, section "blade flapping"; Hoffmann, Huang, Waslander, Tomlin
(2007), Quadrotor helicopter flight dynamics and control, section III.B. A lift that is linear in the tip speed makes both
proportional to w v. A reversed rotor has the opposite axis: its force is against the motion as before, with ``|w|``, and its
moment changes sign with w, as its disc tilts back about the opposite thrust.
"""

import torch
from torch import Tensor

from aerial_gym.math.rows import sum_slices
from aerial_gym.physics.effects.condition import Condition, sum_of_crosses
from aerial_gym.physics.effects.kinds.wrench import LinearWrenchEffect
from aerial_gym.physics.effects.parameter import Parameter


class HForceFlapping(LinearWrenchEffect):
    """In-plane force and hub moment of the rotors."""

    name = "h_force_flapping"
    summary = "in-plane force and hub moment of rotors in sideways flow"
    parameters = (
        Parameter("kh", "N s²/(m rad)", 0.0, 0.1, 1e-5, "force per speed and velocity"),
        Parameter("kf", "N s²/rad", -0.1, 0.1, 1e-6, "hub moment per speed and velocity"),
    )
    excitation = "sideways velocity in both directions; the moment also needs the rotor speeds one by one"
    at_hubs = True
    confused_with = ("rotor_drag", "com_offset", "constant_wind")
    rotors = ("reversible", "slew", "dead_band")
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return (E, 6, 2), the sums over the rotors."""
        flow = condition.rotor_speed.unsqueeze(-1) * condition.edgewise_velocity
        against = condition.rotor_speed.abs().unsqueeze(-1) * condition.edgewise_velocity
        in_plane = torch.cat((-sum_slices(against, 1), sum_of_crosses(against, condition.lever)), dim=1)
        moment = sum_of_crosses(flow, condition.axis)
        return torch.stack((in_plane, torch.cat((torch.zeros_like(moment), moment), dim=1)), dim=2)
