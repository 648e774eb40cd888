"""The hidden effects: their parameters, three sizes of each, and how they change the vehicle.

A hidden effect changes the true vehicle only. The one exception is ``rotor_drag``: the declared vehicle has linear
drag, and where that drag is to be found it is taken out of the declaration.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.undeclared.vehicle import Vehicle

SIZES = ("small", "moderate", "large")
Params = dict[str, float]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One named effect."""

    params: dict[str, float | None]
    """Parameter names and the value of one that is left out; None: it has to be given."""

    ranges: dict[str, Range]
    """Size to the range that ``draw`` takes its magnitude from."""

    draw: Callable[[np.random.Generator, float, Vehicle], Params]
    """Parameters from a generator, a magnitude and the declared vehicle."""

    apply: Callable[[Vehicle, Params], Vehicle]
    """The vehicle that has the effect."""


def _vec(params: Params, names: str) -> np.ndarray:
    return np.array([params[name] for name in names.split()])


def _draw_drag(rng: np.random.Generator, size: float, _: Vehicle) -> Params:
    """Return drag near ``size`` forward and sideways, and about half of it along the rotor axis."""
    dx, dy, dz = size * rng.uniform((0.9, 0.9, 0.4), (1.1, 1.1, 0.7))
    return {"dx": dx, "dy": dy, "dz": dz}


def _draw_scale(rng: np.random.Generator, size: float, _: Vehicle) -> Params:
    return {"scale": 1.0 + rng.choice((-1.0, 1.0)) * size}


def _draw_tau(_rng: np.random.Generator, size: float, declared: Vehicle) -> Params:
    """Return ``size`` times the declared lag (mean of up and down)."""
    return {"tau": size * 0.5 * (declared.tau_up + declared.tau_down)}


def _draw_horizontal(rng: np.random.Generator, size: float, _: Vehicle) -> Params:
    """Return a vector of horizontal length ``size`` in any direction, and up to a third of it along z."""
    angle = rng.uniform(-np.pi, np.pi)
    return {"x": size * np.cos(angle), "y": size * np.sin(angle), "z": size * rng.uniform(-0.33, 0.33)}


def _draw_wind(rng: np.random.Generator, size: float, declared: Vehicle) -> Params:
    """Return wind of horizontal speed ``size`` from any direction, with up to a fifteenth of it along z."""
    wind = _draw_horizontal(rng, size, declared)
    return {**wind, "z": 0.2 * wind["z"]}


def _ranges(small: Range, moderate: Range, large: Range) -> dict[str, Range]:
    return dict(zip(SIZES, (small, moderate, large), strict=True))


EFFECTS: dict[str, Effect] = {
    "rotor_drag": Effect(
        params={"dx": 0.0, "dy": 0.0, "dz": 0.0},  # N s/m
        ranges=_ranges((0.07, 0.10), (0.17, 0.27), (0.35, 0.45)),
        draw=_draw_drag,
        apply=lambda v, p: replace(v, linear_drag=_vec(p, "dx dy dz")),
    ),
    "quadratic_drag": Effect(
        params={"dx": 0.0, "dy": 0.0, "dz": 0.0},  # N s²/m²
        ranges=_ranges((0.012, 0.018), (0.03, 0.05), (0.08, 0.11)),
        draw=_draw_drag,
        apply=lambda v, p: replace(v, quadratic_drag=_vec(p, "dx dy dz")),
    ),
    "thrust_coefficient": Effect(
        params={"scale": None},  # 1 is neutral
        ranges=_ranges((0.015, 0.025), (0.04, 0.06), (0.10, 0.14)),
        draw=_draw_scale,
        apply=lambda v, p: replace(v, thrust_coeff=p["scale"] * v.thrust_coeff),
    ),
    "com_offset": Effect(
        params={"x": 0.0, "y": 0.0, "z": 0.0},  # m
        ranges=_ranges((0.002, 0.003), (0.005, 0.007), (0.010, 0.013)),
        draw=_draw_horizontal,
        apply=lambda v, p: replace(v, com=_vec(p, "x y z")),
    ),
    "motor_time_constant": Effect(
        params={"tau": None},  # s; drawn as a multiple of the declared one
        ranges=_ranges((1.15, 1.25), (1.5, 1.7), (2.0, 2.3)),
        draw=_draw_tau,
        apply=lambda v, p: replace(v, tau_up=p["tau"], tau_down=p["tau"]),
    ),
    "constant_wind": Effect(
        params={"x": 0.0, "y": 0.0, "z": 0.0},  # m/s, world
        ranges=_ranges((0.8, 1.2), (2.0, 3.0), (4.0, 5.0)),
        draw=_draw_wind,
        apply=lambda v, p: replace(v, wind_world=_vec(p, "x y z")),
    ),
}


def resolve(effects: Mapping[str, str | Mapping[str, float]], *, declared: Vehicle, seed: int) -> dict[str, Params]:
    """Return the parameters of each effect: drawn where a size is given, else as given and completed.

    Each effect draws from its own stream, so that its values do not depend on which other effects a case has.

    Raises:
        ValueError: For an unknown effect, size or parameter, or one that is missing.
    """
    return {name: _resolve_one(name, value, declared, seed) for name, value in effects.items()}


def _resolve_one(name: str, value: str | Mapping[str, float], declared: Vehicle, seed: int) -> Params:
    if name not in EFFECTS:
        raise ValueError(f"no effect {name!r}. Known: {', '.join(EFFECTS)}")
    effect = EFFECTS[name]
    if isinstance(value, str):
        if value not in SIZES:
            raise ValueError(f"{name}: no size {value!r}. Known: {', '.join(SIZES)}")
        rng = np.random.default_rng([seed, 1, list(EFFECTS).index(name)])
        drawn = effect.draw(rng, rng.uniform(*effect.ranges[value]), declared)
        return {key: float(number) for key, number in drawn.items()}
    if unknown := set(value) - set(effect.params):
        raise ValueError(f"{name}: no parameter {sorted(unknown)}. Known: {', '.join(effect.params)}")
    params = {key: value.get(key, default) for key, default in effect.params.items()}
    for key, number in params.items():
        if number is None or not np.isfinite(number):
            raise ValueError(f"{name}.{key} = {number!r}: must be given and finite")
    return {key: float(number) for key, number in params.items()}


def split(declared: Vehicle, params: Mapping[str, Params]) -> tuple[Vehicle, Vehicle]:
    """Return the vehicle as it will be declared and as it is, for resolved effects."""
    true = declared
    for name, values in params.items():
        true = EFFECTS[name].apply(true, values)
    if "rotor_drag" in params:
        declared = replace(declared, linear_drag=np.zeros(3))
    return declared, true
