"""Position and velocity of a robot's slung load. Frames: world, z up. Letters: E environments.

With the unit vector n from the body origin to the load and its rate n', at the distance l: ``x = p + l n``, ``v = p' + l n'``.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.physics import BodyState
from aerial_gym.physics.effects import EffectParams, LoadEffect
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec


class SlungLoadState:
    """Keys of the GTD for the load; gradients do not flow through them."""

    def __init__(self, gtd: GlobalTensorDictionary, length: Tensor, state: BodyState) -> None:
        """Declare the keys; ``length`` leads from the body origin to the load [m], (E, 1), and is read at every refresh."""
        self._length, self._state = length, state
        self._position, self._lin_vel = (
            gtd.declare(
                TensorSpec(
                    key=key, shape=("E", 3), unit=unit, frame="world", owner="robot", meaning=f"{quantity} of the load"
                )
            )
            for key, unit, quantity in (("load_position", "m", "place"), ("load_linvel", "m/s", "velocity"))
        )

    @torch.no_grad()
    def refresh(self, load: Tensor) -> None:
        """Write place and velocity for direction and rate of the link, (E, 6)."""
        for target, origin, part in (
            (self._position, self._state.position, load[:, :3]),
            (self._lin_vel, self._state.lin_vel, load[:, 3:]),
        ):
            torch.mul(self._length, part, out=target)
            target.add_(origin)


def make_slung_load(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], state: BodyState
) -> SlungLoadState | None:
    """Return the slung load of a robot; None without one."""
    for effect, params in effects:
        if isinstance(effect, LoadEffect):
            column = [parameter.name for parameter in effect.parameters].index("length")
            return SlungLoadState(gtd, params[:, column : column + 1], state)
    return None
