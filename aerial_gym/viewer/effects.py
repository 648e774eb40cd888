"""Effects of a running simulation: their forces, and switches that change them in flight.

Frames: world z up. Letters: E environments, R rotors, P parameters of an effect, M numbers of memory.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError, OwnershipError
from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics import BodyState, build_model
from aerial_gym.physics.effects import (
    EFFECTS,
    Effect,
    EffectParams,
    RotorEffect,
    VehicleEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.model import check_effects
from aerial_gym.physics.rigid_body import body_wrench
from aerial_gym.physics.torch_backend import TorchBackend
from aerial_gym.viewer.snapshot import Array, to_array

OFFERED = ("constant_wind", "gusts", "rotor_drag", "payload_mass", "com_offset", "weak_motor")
"""Effects that a flight on the page can switch on although the robot file does not have them."""
FORCEFUL = (RotorEffect, WrenchEffect, WindEffect, VehicleEffect)  # Kinds that change the force on the body
SOURCE = "neutral values, which change nothing until the page changes them"


def add_neutral_effects(robot: RobotCfg, names: Iterable[str] | None = None) -> RobotCfg:
    """Return the robot with further effects at their neutral values; without names those of ``OFFERED`` that suit it.

    Raises:
        ConfigError: If a named effect does not suit the robot.
    """
    for name in OFFERED if names is None else names:
        if name not in robot.effects:
            effect = EFFECTS.get(name).bind_robot(robot)
            values = dict(zip((p.name for p in effect.parameters), effect.starts(robot)[0], strict=True))
            wider = replace(
                robot, effects={**robot.effects, name: values}, effects_source=robot.effects_source or SOURCE
            )
            try:
                check_effects(wider)
            except ConfigError:
                if names is not None:
                    raise
                continue
            robot = wider
    return robot


@dataclass
class EffectSwitch:
    """One effect, whose parameters all environments share while the page sets them."""

    effect: Effect
    stored: Tensor  # In the GTD; written by ``apply``, (E, P)
    neutral: tuple[float, ...]  # Values that change nothing
    values: list[float] = field(default_factory=list)  # While it is on
    is_on: bool = False

    def apply(self) -> None:
        """Write the parameters that hold now; the next step uses them."""
        self.stored[:] = self.stored.new_tensor(self.values if self.is_on else self.neutral)

    def limits(self, number: int) -> tuple[float, float]:
        """Return the range of a slider: ten usual changes to both sides of the neutral value, within the bounds."""
        parameter, own = self.effect.parameters[number], self.values[number]
        if parameter.kind == "rotor":
            return 1.0, max(own, 1.0)
        low, high = (self.neutral[number] + sign * 10.0 * parameter.scale for sign in (-1.0, 1.0))
        return max(parameter.low, min(low, own)), min(parameter.high, max(high, own))


def effect_switches(env: EnvManager) -> list[EffectSwitch]:
    """Return a switch for each effect of the robot whose parameters are not drawn at random."""
    switches, robot = [], env.robot_manager.cfg
    for effect, params in env.robot_manager.model.effects:
        key = f"effect_{effect.name}"
        if key not in env.gtd or len(effect.parameters) != params.shape[1]:
            continue
        row, neutral = [float(value) for value in params[0]], tuple(effect.starts(robot)[0])
        switch = EffectSwitch(effect, env.gtd[key], neutral, row, is_on=tuple(row) != neutral)
        try:
            switch.apply()
        except OwnershipError:
            continue
        if not switch.is_on:
            first = next((n for n, parameter in enumerate(effect.parameters) if parameter.kind == "number"), 0)
            low, high = (end - neutral[first] for end in switch.limits(first))
            switch.values[first] += 0.1 * (high or low)
        switches.append(switch)
    return switches


@torch.no_grad()
def effect_forces(env: EnvManager, row: int) -> dict[str, Array]:
    """Return the force of each effect that is not neutral on the vehicle of one environment [N], world, each (3,).

    It is the force with all effects, weight included, minus the force without the one. Effects on sensors, commands and
    loads are left out, and so are vehicles with joints. The vehicle is the declared one, without random draws.
    """
    manager = env.robot_manager
    if manager.articulation is not None:
        return {}
    effects, memory = manager.model.effects, _memory_by_name(env, row)
    rows: list[EffectParams] = [
        (effect, params[row : row + 1].cpu()) for effect, params in effects if isinstance(effect, FORCEFUL)
    ]
    active = [e for e, params in rows if tuple(params[0].tolist()) != tuple(e.starts(manager.cfg)[0])]
    if not active:
        return {}
    rows = [(e, torch.cat((params, memory[e.name]), dim=-1) if e.name in memory else params) for e, params in rows]
    whole = _total_force(env, row, rows)
    return {
        effect.name: to_array(whole - _total_force(env, row, [one for one in rows if one[0] is not effect]))
        for effect in active
    }


def _memory_by_name(env: EnvManager, row: int) -> dict[str, Tensor]:
    """Return the memory of each effect in one environment, (1, M); empty without memory."""
    manager = env.robot_manager
    numbers = manager.backend.state_tensors().get("memory.numbers")
    if numbers is None:
        return {}
    numbers = numbers if isinstance(manager.backend, TorchBackend) else numbers.T
    places = manager.model.effects.places(manager.cfg.num_rotors)
    kept = numbers[row : row + 1].cpu()
    return {place.effect.name: kept[:, place.memory] for place in places if kept[:, place.memory].numel()}


def _total_force(env: EnvManager, row: int, effects: list[EffectParams]) -> Tensor:
    """Return the force on the vehicle of one environment with these effects, weight included [N], world, (3,)."""
    manager = env.robot_manager
    vehicle = manager.declared.map_rows(lambda rows: rows[row : row + 1].cpu())
    plain = [(effect, params[:, : len(effect.parameters)]) for effect, params in effects]
    known = manager.model
    heights = {
        name: value[row : row + 1].cpu() if isinstance(value := getattr(known, name), Tensor) else value
        for name in ("ground_height", "ceiling_height", "other_position")
    }
    model = build_model(vehicle, plain, gravity=known.gravity, **heights)  # pyright: ignore[reportArgumentType]
    model = replace(model, effects=type(known.effects)(effects))
    state: BodyState = manager.tensors.state
    names = ("position", "attitude", "lin_vel", "ang_vel", "rotor_speed")
    position, attitude, lin_vel, ang_vel, speed = (getattr(state, name)[row : row + 1].cpu() for name in names)
    com = model.vehicle.com
    com_vel = lin_vel + quat_rotate(attitude, torch.linalg.cross(ang_vel, com))
    force, _ = body_wrench(
        model, position + quat_rotate(attitude, com), attitude, com_vel, ang_vel, speed, torch.zeros_like(speed)
    )
    weight = force.new_tensor((0.0, 0.0, known.gravity)) * model.vehicle.mass
    return (quat_rotate(attitude, force) - weight)[0]
