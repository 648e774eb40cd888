"""The model: a vehicle with its effects and surroundings, which determine its accelerations.

Frames: body is x forward, y left, z up; world is z up. Letters: E environments, R rotors, P parameters of an effect.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, ShapeError
from aerial_gym.math.rows import inverse_3x3
from aerial_gym.physics.effects import (
    EFFECTS,
    DelayEffect,
    Effect,
    EffectParams,
    EffectsByKind,
    LearnedResidual,
    VehicleEffect,
)
from aerial_gym.physics.vehicle import Vehicle, is_shared, share_row

if TYPE_CHECKING:
    from aerial_gym.physics.articulated.articulation import Articulation


@dataclass(frozen=True, kw_only=True)
class Model:
    """The actual vehicle with the effects on it."""

    vehicle: Vehicle  # Vehicle with the effects on its parameters applied
    inertia_inverse: Tensor  # Inverse of the inertia [1/(kg m²)], (E, 3, 3)
    effects: EffectsByKind  # All effects by kind; those on the vehicle's parameters are already applied to `vehicle`
    gravity: float  # Downward acceleration of free fall [m/s²]
    ground_height: float | Tensor  # Height of the ground [m], world, for effects near it, scalar or (E, 1)
    ceiling_height: float | Tensor | None  # Height of the ceiling [m], world; None without. On torch also (E, 1)
    other_position: Tensor  # Position of another vehicle with a downwash [m], world, (E, 3)
    articulation: "Articulation | None" = None  # Joints and links; `vehicle` is then that of the reference pose

    def to_dtype(self, dtype: torch.dtype) -> "Model":
        """Return the model in another float type."""
        vehicle = self.vehicle.to_dtype(dtype)
        effects = EffectsByKind((effect.to_dtype(dtype), _as_type(params, dtype)) for effect, params in self.effects)
        heights = {
            name: _as_type(height, dtype) if isinstance(height := getattr(self, name), Tensor) else height
            for name in ("ground_height", "ceiling_height")
        }
        other = _as_type(self.other_position, dtype)
        inverse = _inverse(vehicle.inertia)
        bends = None if self.articulation is None else self.articulation.to_dtype_and_device(vehicle.mass)
        return replace(
            self,
            vehicle=vehicle,
            effects=effects,
            inertia_inverse=inverse,
            other_position=other,
            articulation=bends,
            **heights,
        )

    @property
    def longest_delay(self) -> float:
        """Longest delay of commands [s]."""
        return max((effect.longest for effect, _ in self.effects[DelayEffect]), default=0.0)


def load_articulation(robot: RobotCfg, *, like: Tensor) -> "Articulation | None":
    """Return ``build_articulation`` a robot; None for a rigid one, without importing the articulated engine."""
    if robot.joints is None:
        return None
    from aerial_gym.physics.articulated.articulation import build_articulation

    return build_articulation(robot, like=like)


def build_model(
    vehicle: Vehicle, effects: Sequence[EffectParams] = (), *, gravity: float = STANDARD_GRAVITY,
    ground_height: float | Tensor = 0.0, ceiling_height: float | Tensor | None = None,
    other_position: Tensor | None = None, articulation: "Articulation | None" = None,
) -> Model:  # fmt: skip
    """Build the model of a declared vehicle with effects; differentiable in vehicle and parameters.

    Args:
        effects: With their parameters (E, P).
        gravity: Downward acceleration of free fall [m/s²].
        ground_height: Height of the ground [m], world, scalar or (E, 1).
        ceiling_height: Height of the ceiling [m], world, scalar or, on the torch backend only, (E, 1); None without ceiling.
        other_position: Another vehicle with a downwash [m], world, (E, 3); by default infinitely high over the origin.
        articulation: Joints of the vehicle, whose parameters are those of the reference pose; None for a rigid one.

    Raises:
        ShapeError: If the parameters of an effect are not (E, P).
        ConfigError: If an effect lacks an input of the scene, or two effects exclude each other.
    """
    _check_scene(effects, ceiling_height)
    if other_position is None:
        above = torch.tensor((0.0, 0.0, inf), dtype=vehicle.mass.dtype, device=vehicle.mass.device)
        other_position = share_row(above, vehicle.num_envs)
    for effect, params in effects:
        check_effect_on_rotors(effect, vehicle.traits)
        check_effect_on_joints(effect, bends=articulation is not None)
        expected = (vehicle.num_envs, len(effect.parameters))
        if tuple(params.shape) != expected:
            raise ShapeError(f"effect {effect.name}: parameters have shape {tuple(params.shape)}, expected {expected}")
        if isinstance(effect, VehicleEffect):
            vehicle = effect.adjust(vehicle, params)
    return Model(
        vehicle=vehicle,
        inertia_inverse=_inverse(vehicle.inertia),
        effects=EffectsByKind(effects),
        gravity=gravity,
        ground_height=ground_height,
        ceiling_height=ceiling_height,
        other_position=other_position,
        articulation=articulation,
    )


def add_steady_wind(model: Model, velocity: Tensor) -> Model:
    """Return the model with a steady wind [m/s], world, (E, 3), in addition to its own."""
    return replace(model, effects=model.effects.with_effect(EFFECTS.get("constant_wind"), velocity))


def check_effect_on_rotors(effect: Effect | type[Effect], traits: Set[str]) -> None:
    """Raise ``ConfigError`` for rotors of a kind that an effect does not support (``docs/concepts/rotors.md``)."""
    if missing := sorted(traits - set(effect.rotors)):
        raise ConfigError(
            f"effect {effect.name}: its law does not hold for {_TRAIT_WORDS[missing[0]]}. Leave the effect out, or give the "
            "robot plain rotors (mode: speed, thrust_range from 0 on, no slew_rate)"
        )


def check_effect_on_joints(effect: Effect | type[Effect], *, bends: bool) -> None:
    """Raise ``ConfigError`` for an effect that does not suit a vehicle with joints, or a rigid one."""
    alternatives = " or ".join(", ".join(effect.instead).rsplit(", ", 1))
    if not bends and not effect.on_rigid:
        way_out = f"Give it {alternatives}, or joints" if alternatives else "Give it joints"
        raise ConfigError(
            f"effect {effect.name}: is of the links of a vehicle with joints, and this one is rigid. {way_out}"
        )
    if bends and not effect.on_joints:
        way_out = (
            f"Give it {alternatives}, or leave out the joints"
            if alternatives
            else "Leave the effect out, or the joints"
        )
        raise ConfigError(f"effect {effect.name}: is for rigid vehicles, and this one has joints. {way_out}")


_TRAIT_WORDS = {
    "reversible": "reversible rotors (a thrust_range that begins below 0)",
    "force": "rotors in force mode, whose state is a thrust and not a speed",
    "slew": "rotors with a slew_rate",
    "dead_band": "rotors with a dead_band",
}


def _check_scene(effects: Sequence[EffectParams], ceiling_height: float | Tensor | None) -> None:
    for effect, _ in effects:
        if "ceiling_height" in effect.needs and ceiling_height is None:
            raise ConfigError(
                f"effect {effect.name}: there is no ceiling. Give ceiling_height [m] in the environment file"
            )
    first: dict[str, str] = {}
    for effect, _ in effects:
        if effect.single in first:
            raise ConfigError(
                f"effects {first[effect.single]} and {effect.name}: a vehicle has one {effect.single} at most. "
                "Drop one of them"
            )
        if effect.single:
            first[effect.single] = effect.name


def _as_type(rows: Tensor, dtype: torch.dtype) -> Tensor:
    return share_row(rows[0].to(dtype), rows.shape[0]) if is_shared(rows) else rows.to(dtype, copy=True)


def _inverse(inertia: Tensor) -> Tensor:
    inverse = inverse_3x3(inertia[0] if is_shared(inertia) else inertia)
    return share_row(inverse, inertia.shape[0]) if is_shared(inertia) else inverse


def effects_from_config(
    effects: Mapping[str, Mapping[str, float]], *, num_envs: int, device: torch.device, dtype: torch.dtype,
    robot: RobotCfg | None = None,
) -> list[EffectParams]:  # fmt: skip
    """Return the effects of a robot file with their parameters in every environment.

    Effects with parameters for parts of the robot need ``robot``.

    Raises:
        UnknownNameError: If an effect is not registered.
        ConfigError: If a parameter is unknown, missing or out of bounds.
    """
    result = []
    for name, values in effects.items():
        effect = EFFECTS.get(name) if robot is None else EFFECTS.get(name).bind_robot(robot)
        row = torch.tensor(effect.parse_params(values), dtype=dtype, device=device)
        result.append((effect, row.expand(num_envs, -1).clone()))
    return result


def robot_effects(
    robot: RobotCfg, *, num_envs: int, device: torch.device, dtype: torch.dtype, rigid: bool = False
) -> list[EffectParams]:
    """Return the effects of a robot, with its learned residual.

    With ``rigid`` the robot counts as rigid in its reference pose, and effects on links are omitted.
    """
    effects = effects_on_rigid(robot) if rigid else robot.effects
    result = effects_from_config(effects, num_envs=num_envs, device=device, dtype=dtype, robot=robot)
    if robot.learned_residual is not None:
        learned = LearnedResidual(robot.learned_residual, dtype=dtype, device=device)
        result.append((learned, torch.ones(num_envs, 1, dtype=dtype, device=device)))
    return result


def effects_on_rigid(robot: RobotCfg) -> dict[str, Mapping[str, float]]:
    """Return the effects of a robot file that act on a vehicle taken as rigid in its reference pose."""
    return {
        name: values for name, values in robot.effects.items() if robot.joints is None or EFFECTS.get(name).on_rigid
    }


def check_effects(robot: RobotCfg) -> None:
    """Raise the errors of ``effects_from_config``, and those of missing inputs in the robot file, without making tensors."""
    for name, values in robot.effects.items():
        effect = EFFECTS.get(name).bind_robot(robot)
        check_effect_on_rotors(effect, robot.rotor_traits)
        check_effect_on_joints(effect, bends=robot.joints is not None)
        effect.check(robot)
        row = dict(zip((p.name for p in effect.parameters), effect.parse_params(values), strict=True))
        for parameter in effect.parameters:
            if parameter.kind == "rotor" and row[parameter.name] not in range(1, robot.num_rotors + 1):
                raise ConfigError(
                    f"effect {name}.{parameter.name} = {row[parameter.name]:g}: must be a rotor, 1 to {robot.num_rotors}"
                )
