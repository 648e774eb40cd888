"""Random draws of quantities at a reset, inside a kernel, and the effect of a draw on the vehicle.

Letters: E environments, R rotors, K drawn numbers.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, log
from typing import Literal
from zlib import crc32

import numpy as np
import torch
import warp as wp
from torch import Tensor

from aerial_gym.config.randomize import Randomize, RandomizeCfg
from aerial_gym.errors import ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.interop.rows import KernelInput
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.physics import EFFECTS, Vehicle

BATTERY = ("nominal_voltage", "full_voltage", "empty_voltage", "internal_resistance", "capacity", "efficiency")
"""Columns of ``Vehicle.battery``."""


def apply_draw(cfg: RandomizeCfg, declared: Tensor, draw: Tensor) -> Tensor:
    """Return a quantity from its declared value and its draw."""
    if cfg.how == "value":
        return draw + torch.zeros_like(declared)
    return declared * draw if cfg.how == "scale" else declared + draw


def scale_second_moments(inertia: Tensor, factor: Tensor) -> Tensor:
    """Return an inertia (E, 3, 3) with factors (E, 3) on the mass's second moments along the body axes.

    ``S = tr(J)/2 1 - J`` is the integral of ``x x^T dm``; stretched to ``D S D`` with ``D = diag(sqrt(factor))`` it is that of
    another body, so that the moments of ``J = tr(S) 1 - S`` keep the triangle inequality. The same factor on all axes
    is a factor on J.
    """
    stretch = factor.sqrt()
    trace = inertia.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None]
    unit = torch.eye(3, dtype=inertia.dtype, device=inertia.device)
    moments = stretch.unsqueeze(-1) * (0.5 * trace * unit - inertia) * stretch.unsqueeze(-2)
    return moments.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None] * unit - moments


Width = Literal["one", "vector", "rotor", "rotor_vector"]


@dataclass(frozen=True)
class Quantity:
    """A quantity of the vehicle."""

    unit: str  # SI unit
    width: Width  # One number, three components, a number for each rotor, or three components for each rotor
    apply: Callable[[Vehicle, RandomizeCfg, Tensor], Vehicle]  # Adds a draw: (E,), (E, 3), (E, R) or (E, R, 3)
    meaning: str  # One line
    declared: str | None = None  # Field of `Vehicle` with the declared value; None for factors
    how: tuple[str, ...] = ("scale", "offset", "value")  # Allowed draws of the quantity


def _set_mass(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    mass = apply_draw(cfg, vehicle.mass, draw)
    if cfg.keep_inertia:
        return replace(vehicle, mass=mass)
    return replace(vehicle, mass=mass, inertia=vehicle.inertia * (mass / vehicle.mass)[:, None, None])


def _set_fields(names: tuple[str, ...], vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    drawn: dict[int, Tensor] = {}
    for declared in (getattr(vehicle, name) for name in names):  # one tensor for all names stays one
        if id(declared) not in drawn:
            drawn[id(declared)] = apply_draw(cfg, declared, draw)
    return replace(vehicle, **{name: drawn[id(getattr(vehicle, name))] for name in names})


def _scale_maps(maps: tuple[str, ...], vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    return vehicle.with_scaled_maps(**dict.fromkeys(maps, draw))


def _offset_axes(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    axis = apply_draw(cfg, vehicle.rotor_axis, draw)
    return replace(vehicle, rotor_axis=axis / axis.norm(dim=-1, keepdim=True))


def _set_battery(column: int, vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    columns = list(vehicle.battery.unbind(-1))
    columns[column] = apply_draw(cfg, columns[column], draw)
    return replace(vehicle, battery=torch.stack(columns, dim=-1))


def _set_charge(vehicle: Vehicle, cfg: RandomizeCfg, draw: Tensor) -> Vehicle:
    """Begin on the line from full to empty at a share c of the charge: ``E0' = E1 + c (E0 - E1)``, ``Q' = c Q``."""
    nominal, full, empty, resistance, capacity, efficiency = vehicle.battery.unbind(-1)
    columns = (nominal, empty + draw * (full - empty), empty, resistance, draw * capacity, efficiency)
    return replace(vehicle, battery=torch.stack(columns, dim=-1))


def _quantity_of_fields(unit: str, width: Width, meaning: str, *fields: str) -> Quantity:
    return Quantity(unit, width, partial(_set_fields, fields), meaning, fields[0])


_set_maps, _set_torque_map = partial(_scale_maps, ("thrust", "torque")), partial(_scale_maps, ("torque",))
_both_lags = ("time_constant_up", "time_constant_down")

QUANTITIES: dict[str, Quantity] = {
    "body.mass": Quantity("kg", "one", _set_mass, "mass; the inertia grows with it (keep_inertia)", "mass"),
    "body.com": _quantity_of_fields("m", "vector", "centre of mass from the body origin, body", "com"),
    "body.inertia": Quantity(
        "-", "vector", lambda vehicle, _, draw: replace(vehicle, inertia=scale_second_moments(vehicle.inertia, draw)),
        "factors on the mass's second moments along the body axes: stays that of a body",
        how=("scale",),
    ),
    "rotor.thrust_map": Quantity("-", "rotor", _set_maps, "thrust and drag torque of a speed", how=("scale",)),
    "rotor.torque_map": Quantity("-", "rotor", _set_torque_map, "drag torque of a speed alone", how=("scale",)),
    "rotor.time_constant": _quantity_of_fields("s", "rotor", "lag, rising and falling", *_both_lags),
    "rotor.time_constant_up": _quantity_of_fields("s", "rotor", "lag of a speed that grows", "time_constant_up"),
    "rotor.time_constant_down": _quantity_of_fields("s", "rotor", "lag of a speed that falls", "time_constant_down"),
    "rotor.slew_rate": _quantity_of_fields(
        "rad/s² or N/s", "rotor", "largest rates of the rotor's state", "slew_rate", "slew_rate_down"
    ),
    "rotor.dead_band": _quantity_of_fields("rad/s or N", "rotor", "commands that stop the rotor", "dead_band"),
    "rotor.radius": _quantity_of_fields("m", "rotor", "radius of the propeller", "rotor_radius"),
    "mounts.*.position": _quantity_of_fields("m", "rotor_vector", "hubs from the body origin, body", "rotor_position"),
    "mounts.*.axis": Quantity(
        "-", "rotor_vector", _offset_axes, "directions of thrust, made unit length", "rotor_axis", how=("offset",)
    ),
    **{
        f"battery.{name}": Quantity("see BatteryCfg", "one", partial(_set_battery, column), f"{name} of the battery")
        for column, name in enumerate(BATTERY)
    },
    "battery.charge": Quantity(
        "-", "one", _set_charge, "share of the charge with which an episode begins", how=("value",)
    ),
}  # fmt: skip
"""Quantities of every vehicle; those of effects, gains and sensors depend on the robot."""


def quantity_table() -> str:
    """Return all names that ``randomize:`` knows as a table in Markdown; those of effects by effect."""
    from aerial_gym.physics import EFFECTS

    widths = {"one": "1", "vector": "3", "rotor": "1 or R", "rotor_vector": "3 or R x 3"}
    rows = ["| name | unit | numbers | how | what is drawn |", "| --- | --- | --- | --- | --- |"]
    for name, each in QUANTITIES.items():
        rows.append(f"| `{name}` | {each.unit} | {widths[each.width]} | {', '.join(each.how)} | {each.meaning} |")
    for name in sorted(EFFECTS):
        for each in EFFECTS.get(name).parameters:
            how = "value, integer" if each.kind == "rotor" else "scale, offset, value"
            rows.append(f"| `effects.{name}.{each.name}` | {each.unit} | 1 | {how} | {each.meaning} |")
    return "\n".join(rows)


ROUND_OFF = 1e-6
"""Share of independence in a joint distribution: of two numbers of which the sum alone is known, the matrix is singular, and
below zero by round-off. It widens exact correlations by a thousandth of the standard deviation."""


def correlation_factor(cfg: Randomize) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the names of correlated quantities and the lower Cholesky factor of their correlations, (N, N).

    Raise ``ConfigError`` if one is not drawn, or is no normal single number, or if the correlations contradict each other.
    """
    stated = {(name, other): value for name, each in cfg.items() for other, value in each.correlation.items()}
    for name, other in stated:
        label = f"randomize: {name}: correlation with {other!r}"
        if other not in cfg:
            raise ConfigError(f"{label}, which is not drawn. Draw it, or drop the correlation")
        if name == other or (other, name) in stated:
            raise ConfigError(f"{label}: give each pair of two quantities once")
        for one in (name, other):
            if cfg[one].distribution != "normal" or cfg[one].each_rotor or cfg[one].component_counts() != {1}:
                raise ConfigError(f"{label}: {one} must be a normal distribution of one number")
    joint = tuple(name for name in cfg if any(name in pair for pair in stated))
    matrix = np.eye(len(joint))
    for (name, other), value in stated.items():
        i, j = joint.index(name), joint.index(other)
        matrix[i, j] = matrix[j, i] = value
    try:
        return joint, np.linalg.cholesky((1.0 - ROUND_OFF) * matrix + ROUND_OFF * np.eye(len(joint)))
    except np.linalg.LinAlgError:
        raise ConfigError(
            f"randomize: the correlations of {', '.join(joint)} contradict each other: their matrix is not positive definite"
        ) from None


@dataclass(frozen=True, kw_only=True)
class RandomQuantity:
    """A randomised quantity and its columns among the K numbers."""

    name: str  # Of the quantity
    cfg: RandomizeCfg  # Its distribution
    shape: tuple[int, ...]  # Of its draw in one environment
    columns: slice  # Among the K numbers


@wp.struct
class DrawLimits:
    """Distribution parameters and limits of one number."""

    low: wp.float32  # of the number; of its logarithm; of the normal probability
    high: wp.float32
    mean: wp.float32
    std: wp.float32
    least: wp.float32  # limits that rounding must not exceed
    most: wp.float32


@wp.struct
class DrawArrays:
    """Inputs of the draws of an environment."""

    random: RandomArrays
    shared: RandomArrays  # of all vehicles of an environment
    draws: wp.array[DrawLimits]  # (K,)
    factor: wp.array2d[float]  # (K, K), lower Cholesky factor of the correlations of joint numbers


@wp.func
def uniform_value(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a uniform draw between ``low`` and ``high``."""
    return draw.low + (draw.high - draw.low) * wp.randf(state)


@wp.func
def normal_quantile(share: float) -> float:
    """Return the inverse of the cumulative normal distribution."""
    return wp.sqrt(2.0) * wp.erfinv(wp.clamp(2.0 * share - 1.0, -0.9999999, 0.9999999))


@wp.func
def independent_normal(state: wp.uint32) -> float:
    """Return a normal draw of mean 0 and standard deviation 1."""
    return normal_quantile(wp.randf(state))


@wp.func
def uniform(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of a uniform distribution."""
    return wp.clamp(uniform_value(draw, state), draw.least, draw.most)


@wp.func
def log_uniform(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw whose logarithm is uniform."""
    return wp.clamp(wp.exp(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def normal(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of a truncated normal distribution."""
    return wp.clamp(draw.mean + draw.std * normal_quantile(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def integer(draw: DrawLimits, state: wp.uint32) -> float:
    """Return a draw of whole numbers; ``high`` is one beyond the last."""
    return wp.clamp(wp.floor(uniform_value(draw, state)), draw.least, draw.most)


@wp.func
def joint(draw: DrawLimits, weighted: float) -> float:
    """Return a number of a joint normal distribution; ``weighted`` is its row of the factor times independent normal draws."""
    return wp.clamp(draw.mean + draw.std * weighted, draw.least, draw.most)


_CALLED = (episode_stream, substream, independent_normal, uniform, log_uniform, normal, integer, joint)


def draw_code(drawn: Sequence[RandomQuantity], random: Randomness, *, device: torch.device) -> KernelInput:
    """Return the kernel code of the draws of one environment, all independent."""
    start_warp()
    rows = np.zeros(drawn[-1].columns.stop, dtype=DrawLimits.numpy_dtype())  # type: ignore[call-overload]
    for each in drawn:
        width = each.columns.stop - each.columns.start
        for i, numbers in enumerate(each.cfg.component_distributions(width)):
            _fill_limits(rows[each.columns.start + i], each.cfg.distribution, *numbers)
    first = {each.name: each.columns.start for each in drawn}
    together, small = correlation_factor({each.name: each.cfg for each in drawn})
    if random.shared is not random and len({is_shared_by_vehicles(name) for name in together}) == 2:
        raise ConfigError(
            f"randomize: {', '.join(together)} are correlated, but the air belongs to an environment and the rest to its "
            "vehicles. Drop the correlation between them, or take one vehicle for each environment"
        )
    columns, factor = [first[name] for name in together], np.zeros((len(rows), len(rows)), dtype=np.float32)
    factor[np.ix_(columns, columns)] = small
    given, target = DrawArrays(), wp.device_from_torch(device)
    given.random, given.shared = random_arrays(random), random_arrays(random.shared)
    given.draws, given.factor = wp.array(rows, dtype=DrawLimits, device=target), wp.array(factor, device=target)
    names = {function.key: function for function in _CALLED}
    return KernelInput(lines=tuple(_kernel_lines(drawn, columns)), names=names, given_type=DrawArrays, given=given)


def is_shared_by_vehicles(name: str) -> bool:
    """Return whether a random quantity belongs to the environment: a parameter of its air."""
    family, _, rest = name.partition(".")
    return family == "effects" and EFFECTS.get(rest.partition(".")[0]).acts_on == "environment"


def _kernel_lines(drawn: Sequence[RandomQuantity], joint_columns: Sequence[int]) -> Iterator[str]:
    """Yield the kernel lines that draw each number; ``joint_columns`` are the columns of the joint distribution."""
    for source in ("random", "shared"):
        yield f"{source} = episode_stream(given.{source}, row, {int(Purpose.PARAMETERS)})"
    for i, each in enumerate(drawn):
        source = "shared" if is_shared_by_vehicles(each.name) else "random"
        yield f"quantity_{i} = substream({source}, {crc32(each.name.encode()) & 0x7FFFFFFF})"
        for element, k in enumerate(range(each.columns.start, each.columns.stop)):
            state = f"substream(quantity_{i}, {element})"
            if k in joint_columns:
                yield f"normal_{k} = independent_normal({state})"
            else:
                yield f"made_{k} = {each.cfg.distribution}(given.draws[{k}], {state})"
    for i, k in enumerate(joint_columns):
        weighted = " + ".join(f"given.factor[{k}, {j}] * normal_{j}" for j in joint_columns[: i + 1])
        yield f"made_{k} = joint(given.draws[{k}], {weighted})"


def _fill_limits(row: np.void, distribution: str, low: float, high: float, mean: float, std: float) -> None:
    row["mean"], row["std"] = mean, std
    row["least"], row["most"] = max(low, -3e38), min(high, 3e38)
    if distribution == "normal":
        low, high = _normal_probability(low, mean, std), _normal_probability(high, mean, std)
    elif distribution == "log_uniform":
        low, high = log(low), log(high)
    elif distribution == "integer":
        high += 1.0
    row["low"], row["high"] = low, high


def _normal_probability(limit: float, mean: float, std: float) -> float:
    """Return the probability of a normal number below a limit."""
    from statistics import NormalDist

    return float(limit > 0.0) if abs(limit) == inf else NormalDist(mean, std).cdf(limit)
