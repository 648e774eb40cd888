"""Domain randomisation of a robot: named quantities, their columns, and the resulting vehicle, parameters and gains.

Letters: E environments, R rotors, K drawn numbers, P parameters of an effect.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, isfinite, prod
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, suggest_name
from aerial_gym.physics import EFFECTS, Vehicle
from aerial_gym.physics.effects import Effect, Parameter
from aerial_gym.physics.vehicle import own_rows, share_row
from aerial_gym.robots.parameter_draws import BATTERY, QUANTITIES, RandomQuantity, apply_draw, correlation_factor

if TYPE_CHECKING:
    from aerial_gym.physics.articulated.articulation import Articulation

_ONE_MOUNT = re.compile(r"mounts\.(\d+)\.(\w+)")


def add_effects_to_randomise(robot: RobotCfg, cfg: Randomize) -> RobotCfg:
    """Return the robot plus the effects that only its draws name, at their neutral parameters."""
    effects = dict(robot.effects)
    for name in cfg:
        parts = name.split(".", 2)
        if len(parts) == 3 and parts[0] == "effects" and parts[1] in EFFECTS and parts[1] not in effects:
            effect = EFFECTS.get(parts[1])
            neutral = zip((p.name for p in effect.parameters), effect.neutral(robot), strict=True)
            effects[parts[1]] = dict(neutral)
    if len(effects) == len(robot.effects):
        return robot
    return replace(robot, effects=effects, effects_source=robot.effects_source or "randomize: neutral where not drawn")


def quantity_names(robot: RobotCfg, *, gains: Iterable[str]) -> list[str]:
    """Return the names of everything that may be drawn of a robot and ``gains``; any effect may, though the file lacks it."""
    names = [name for name in QUANTITIES if robot.battery is not None or not name.startswith("battery.")]
    names += [f"mounts.{i + 1}.{field}" for i in range(robot.num_rotors) for field in ("position", "axis")]
    names += [f"effects.{name}.{p.name}" for name in sorted(EFFECTS) for p in _effect_parameters(name, robot)]
    return names + [f"gains.{name}" for name in gains]


def check_names(cfg: Randomize, known: Sequence[str]) -> None:
    """Raise ``ConfigError`` that names the nearest known quantity if one is unknown."""
    for name in cfg:
        if name not in known:
            raise ConfigError(
                f"randomize: no quantity {name!r}.{suggest_name(name, known)} docs/guides/randomise.md lists them"
            )


@dataclass(frozen=True, kw_only=True)
class DrawResult:
    """Vehicle, effect parameters and gains that follow from draws."""

    vehicle: Vehicle  # With the drawn quantities, before the effects
    params: tuple[Tensor, ...]  # Parameters (E, P) of every effect
    gains: dict[str, Tensor]  # Drawn gains by name, (E, 3)


class RobotDraws:
    """Layout of the draws of one robot; its methods are plain torch on rows."""

    def __init__(
        self, cfg: Randomize, robot: RobotCfg, declared: Vehicle, effects: Sequence[tuple[Effect, Tensor]],
        gains: Mapping[str, Tensor],
    ) -> None:  # fmt: skip
        """Assign a column to every number.

        Args:
            gains: Declared gains by name, (E, 3); none where the controller has none.
        """
        check_names(cfg, quantity_names(robot, gains=gains))
        self._num_rotors, self._declared = declared.num_rotors, declared
        self._vehicle = {name: rows[0].tolist() for name, rows in declared.tensors_by_name().items()}
        self._effects = [effect for effect, _ in effects]
        self._params = [params[0].tolist() for _, params in effects]
        self._gains = {name: rows[0].tolist() for name, rows in gains.items()}
        self._gain_rows = {name: own_rows(rows[:1])[0] for name, rows in gains.items()}
        correlation_factor(cfg)
        self.drawn: list[RandomQuantity] = []
        first = 0
        for name, each in cfg.items():
            shape = self._draw_shape(name, each)
            self.drawn.append(
                RandomQuantity(name=name, cfg=each, shape=shape, columns=slice(first, first + prod(shape)))
            )
            first += prod(shape)
            self._check_range(name, each)
            if each.correlation and prod(shape) != 1:
                raise ConfigError(f"randomize: {name}: correlation is for quantities of one number")
        self.width = first
        """K."""

    @property
    def random_effects(self) -> list[int]:
        """Indices of the effects with random parameters."""
        names = {each.name.split(".")[1] for each in self.drawn if each.name.startswith("effects.")}
        return [i for i, effect in enumerate(self._effects) if effect.name in names]

    @property
    def random_gains(self) -> list[str]:
        """Names of the random gains."""
        return [each.name.split(".")[1] for each in self.drawn if each.name.startswith("gains.")]

    def draws_by_name(self, values: Tensor) -> dict[str, Tensor]:
        """Return the draws by name, (E, ...), as views of the numbers (E, K)."""
        return {each.name: values[:, each.columns].view(-1, *each.shape) for each in self.drawn}

    def fill_neutral(self, values: Tensor) -> None:
        """Fill the numbers (E, K) with draws that leave everything as declared."""
        for each in self.drawn:
            how = each.cfg.how
            value = self._nominal_value(each.name, each.cfg).to(values.device).flatten()
            values[:, each.columns] = 1.0 if how == "scale" else 0.0 if how == "offset" else value

    def apply_draws(self, values: Tensor, *params: Tensor, vehicle: Vehicle | None = None) -> DrawResult:
        """Return vehicle, effect parameters and gains for draws (E, K) and the present parameters (E, P) of all effects.

        Args:
            vehicle: As declared, with tensors on the device; if not given, it is made of plain numbers.
        """
        count = values.shape[0]

        def rows(numbers: list[float]) -> Tensor:
            return share_row(torch.tensor(numbers, dtype=values.dtype, device=values.device), count)

        bare = vehicle is None
        if vehicle is None:
            vehicle = replace(self._declared, **{name: rows(numbers) for name, numbers in self._vehicle.items()})
        columns = [list(each.unbind(-1)) for each in params]
        gains: dict[str, Tensor] = {}
        for each in self.drawn:
            draw = values[:, each.columns].reshape(-1, *each.shape)
            family, *rest = each.name.split(".", 2)
            if family == "effects":
                at, k = self._parameter_place(*rest)
                declared = torch.full_like(columns[at][k], self._params[at][k])
                columns[at][k] = apply_draw(each.cfg, declared, draw)
            elif family == "gains":
                declared = rows(self._gains[rest[0]]) if bare else share_row(self._gain_rows[rest[0]], count)
                gains[rest[0]] = apply_draw(each.cfg, declared, draw)
            else:
                vehicle = self._apply_to_vehicle(vehicle, each, draw)
        return DrawResult(vehicle=vehicle, params=tuple(torch.stack(each, dim=-1) for each in columns), gains=gains)

    def _apply_to_vehicle(self, vehicle: Vehicle, each: RandomQuantity, draw: Tensor) -> Vehicle:
        one = _ONE_MOUNT.fullmatch(each.name)
        if one is None:
            return QUANTITIES[each.name].apply(vehicle, each.cfg, draw.expand(-1, *self._full_shape(each.name)))
        field = _mount_field(one[2])
        everywhere = QUANTITIES[f"mounts.*.{one[2]}"].apply(
            vehicle, each.cfg, draw.unsqueeze(1).expand(-1, self._num_rotors, 3)
        )
        chosen = torch.arange(1, self._num_rotors + 1, device=draw.device).view(1, -1, 1) == int(one[1])
        return replace(vehicle, **{field: torch.where(chosen, getattr(everywhere, field), getattr(vehicle, field))})

    def _full_shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of a quantity of the vehicle in one environment."""
        width = QUANTITIES[name].width
        return {"one": (), "vector": (3,), "rotor": (self._num_rotors,), "rotor_vector": (self._num_rotors, 3)}[width]

    def _draw_shape(self, name: str, cfg: RandomizeCfg) -> tuple[int, ...]:
        """Return the shape of the draw of a quantity in one environment."""
        if name not in QUANTITIES:
            shape = () if name.startswith("effects.") else (3,)
            if cfg.each_rotor:
                raise ConfigError(f"randomize: {name}: each_rotor is for quantities of all rotors")
            return shape
        full, rotor = self._full_shape(name), QUANTITIES[name].width.startswith("rotor")
        if cfg.how not in QUANTITIES[name].how:
            raise ConfigError(f"randomize: {name}: how = {cfg.how!r} must be one of {', '.join(QUANTITIES[name].how)}")
        if cfg.each_rotor and not rotor:
            raise ConfigError(f"randomize: {name}: each_rotor is for quantities of all rotors")
        return (1, *full[1:]) if rotor and not cfg.each_rotor else full

    def _nominal_value(self, name: str, cfg: RandomizeCfg) -> Tensor:
        """Return the declared value of a quantity, in the shape of its draw; 1 for factors."""
        family, *rest = name.split(".", 2)
        if family == "effects":
            at, k = self._parameter_place(*rest)
            return torch.tensor(self._params[at][k])
        if family == "gains":
            return torch.tensor(self._gains[rest[0]])
        one = _ONE_MOUNT.fullmatch(name)
        if one is not None:
            return torch.tensor(self._vehicle[_mount_field(one[2])][int(one[1]) - 1])
        if family == "battery" and rest[0] in BATTERY:
            return torch.tensor(self._vehicle["battery"][BATTERY.index(rest[0])])
        shape, field = self._draw_shape(name, cfg), QUANTITIES[name].declared
        declared = torch.ones(shape) if field is None else torch.tensor(self._vehicle[field])
        return declared[: shape[0]] if shape else declared

    def _parameter_place(self, effect: str, parameter: str) -> tuple[int, int]:
        """Return the number of an effect, and that of its parameter."""
        at = [each.name for each in self._effects].index(effect)
        return at, [each.name for each in self._effects[at].parameters].index(parameter)

    def _check_range(self, name: str, cfg: RandomizeCfg) -> None:
        """Raise ``ConfigError`` for a range beyond the possible values, or a quantity that the robot lacks."""
        trait = {"rotor.slew_rate": "slew", "rotor.dead_band": "dead_band"}.get(name)
        if trait is not None and trait not in self._declared.traits:
            raise ConfigError(f"randomize: {name}: the rotors of this robot have none. Declare one in its file")
        declared, parameter = self._nominal_value(name, cfg).flatten().tolist(), None
        if name.startswith("effects."):
            at, k = self._parameter_place(*name.split(".", 2)[1:])
            parameter = self._effects[at].parameters[k]
        least, most = _possible_range(name, parameter, self._num_rotors)
        if parameter is not None and parameter.kind == "rotor" and (cfg.distribution, cfg.how) != ("integer", "value"):
            raise ConfigError(f"randomize: {name} is the number of a rotor. Give how: value, distribution: integer")
        for low, high in cfg.value_limits(name, declared):
            if not (least <= low and high <= most):
                raise ConfigError(
                    f"randomize: {name} reaches {low:g} to {high:g}: must stay within [{least:g}, {most:g}]. "
                    "Give low and high"
                )


def _mount_field(name: str) -> str:
    """Return the field of ``Vehicle`` for ``position`` or ``axis`` of mounts."""
    return str(QUANTITIES[f"mounts.*.{name}"].declared)


def _effect_parameters(effect: str, robot: RobotCfg) -> tuple[Parameter, ...]:
    """Return the parameters that an effect has on a robot."""
    return (
        EFFECTS.get(effect).bind_robot(robot).parameters if effect in robot.effects else EFFECTS.get(effect).parameters
    )


def _possible_range(name: str, parameter: Parameter | None, num_rotors: int) -> tuple[float, float]:
    """Return the lowest and highest value of a quantity that is possible, a parameter of an effect or not."""
    if parameter is not None:
        return parameter.low, num_rotors if parameter.kind == "rotor" else parameter.high
    family = name.partition(".")[0]
    if name == "battery.charge":
        return 1e-3, 1.0
    if name in ("body.com",) or family == "mounts":
        return -inf, inf
    return (
        (0.0, inf) if name in ("rotor.dead_band", "battery.internal_resistance") or family == "gains" else (1e-9, inf)
    )


def check_base_draws(randomized: RobotDraws, articulation: "Articulation", params: Sequence[Tensor]) -> None:
    """Raise ``ConfigError`` where a corner of the ranges of ``body.`` leaves a base that flies without mass or inertia."""
    drawn = [each for each in randomized.drawn if each.name.startswith("body.")]
    ends, columns = [], []
    for each in drawn:
        numbers = each.cfg.component_distributions(each.columns.stop - each.columns.start)
        for column, (low, high, _, _) in enumerate(numbers, each.columns.start):
            if isfinite(low) and isfinite(high):
                ends.append((low, high))
                columns.append(column)
    if not columns or not articulation.tree.floating:
        return
    corners = torch.tensor(list(product(*ends)), dtype=torch.float64)
    values = corners.new_zeros(len(corners), randomized.width)
    randomized.fill_neutral(values)
    values[:, columns] = corners
    rows = (each[:1].to(corners).expand(len(corners), -1) for each in params)
    links = articulation.to_dtype_and_device(corners).links(randomized.apply_draws(values, *rows).vehicle)
    mass, least = links.mass[:, 0].min().item(), torch.linalg.eigvalsh(links.inertia[:, 0]).min().item()
    if not (mass > 0.0 and least > 0.0):
        names, carried = ", ".join(each.name for each in drawn), float(articulation.link_mass.sum())
        raise ConfigError(
            f"randomize: {names}: the links weigh {carried:.6g} kg whatever is drawn, and leave a base of {mass:.3g} kg and a "
            f"principal moment of {least:.3g} kg m² at a corner of the ranges. Both must be > 0: give narrower ranges"
        )
