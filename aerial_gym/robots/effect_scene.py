"""Surroundings that effects read: another vehicle and the surface below. Letters: E environments."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from torch import Tensor

from aerial_gym.errors import CapabilityError
from aerial_gym.physics.effects import EffectParams, RotorEffect
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
    """Declare the surroundings that the effects read; ``obstacles`` adds surfaces other than the ground, without gradients."""
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
