"""Tensors of effects in the GTD: surroundings that they read, a slung load, and the guards of parameters.

With the unit vector n from the body origin to a load and its rate n', at the distance l: ``x = p + l n``, ``v = p' + l n'``.
Frames: world, z up. Letters: E environments.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from math import inf

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.physics import BodyState
from aerial_gym.physics.effects import EffectParams, LoadEffect, RotorEffect
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec


@dataclass(frozen=True, kw_only=True)
class EffectScene:
    """Tensors of the GTD; None if no effect reads them."""

    other_position: Tensor | None  # Position of the vehicle above, source of downwash [m], world, (E, 3)
    surface_height: Tensor | None  # Height of the first surface below the robot [m], world, (E, 1)

    @property
    def sources(self) -> tuple[Tensor, ...]:
        """The tensors that are not None, in the order of ``pop_rows``."""
        return tuple(each for each in (self.other_position, self.surface_height) if each is not None)

    def pop_rows(self, rest: list[Tensor]) -> "EffectScene":
        """Remove the rows (E, ...) of these tensors from the end of a list and return them."""
        surface = None if self.surface_height is None else rest.pop()
        other = None if self.other_position is None else rest.pop()
        return EffectScene(other_position=other, surface_height=surface)


def declare_effect_scene(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], *, obstacles: bool, gradients: bool
) -> EffectScene:
    """Declare the tensors that the effects read: another vehicle's position and, with ``obstacles``, the height below."""
    other = surface = None
    if any("other_position" in effect.needs for effect, _ in effects):
        other = gtd.declare(TensorSpec(
            key="downwash_position", shape=("E", 3), unit="m", frame="world", owner="robot",
            meaning="position of another vehicle, source of downwash",
        ))  # fmt: skip
        other[:, 2] = inf
    near = [effect.name for effect, _ in effects if isinstance(effect, RotorEffect) and "position" in effect.needs]
    if near and obstacles:
        if gradients:
            raise CapabilityError(f"effect {near[0]}: no gradients over obstacles. Leave them or the effect out")
        surface = gtd.declare(TensorSpec(
            key="surface_height", shape=("E", 1), unit="m", frame="world", owner="env",
            meaning=f"first surface straight below the robot at the start of the step, which {', '.join(near)} feel",
        ))  # fmt: skip
    return EffectScene(other_position=other, surface_height=surface)


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


FOLLOWS = {"robot_mass": ("body.mass", "payload_mass"), "robot_inertia": ("body.inertia", "inertia_error")}
"""Keys that follow from the robot: the quantity that may be drawn, and the effect that may be written, in their place."""

LIVE = ("drawn_parameters", "downwash_position")  # Writable keys besides those of effects, read by the next step


def watch_parameter_writes(
    gtd: GlobalTensorDictionary, effects: Sequence[EffectParams], drawn: Collection[int], *, notice: Callable[[], None]
) -> None:
    """Let writes to independent parameters call ``notice``; refuse those to derived ones and effects ``drawn``."""
    for key, (quantity, effect) in FOLLOWS.items():
        gtd.refuse(
            key,
            f"it follows from the robot. Write effect_{effect} of a robot with that effect, or draw {quantity} (randomize) "
            f"and write draws()[{quantity!r}]",
        )
    if "robot_imu_errors" in gtd:
        gtd.refuse("robot_imu_errors", "write effect_imu_bias or effect_imu_misalignment, from which it follows")
    for i, (effect, _) in enumerate(effects):
        if i in drawn:
            way_out = f"it is drawn. Write draws()['effects.{effect.name}.PARAMETER'], or do not draw it"
            gtd.refuse(f"effect_{effect.name}", way_out)
        else:
            gtd.watch(f"effect_{effect.name}", notice)
    for key in LIVE:
        if key in gtd:
            gtd.watch(key, notice)
