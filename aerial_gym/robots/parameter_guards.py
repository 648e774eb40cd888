"""Write access to robot parameters in the Global Tensor Dictionary, and the alternative to each refused one."""

from collections.abc import Callable, Collection, Sequence

from aerial_gym.physics.effects import EffectParams
from aerial_gym.registry import GlobalTensorDictionary

FOLLOWS = {"robot_mass": ("body.mass", "payload_mass"), "robot_inertia": ("body.inertia", "inertia_error")}
"""Keys that follow from the robot: the quantity that may be drawn, and the effect that may be written, in their place."""

LIVE = ("drawn_parameters", "downwash_position")
"""Writable keys besides those of effects; the next step uses the new values."""


def guard_parameters(
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
