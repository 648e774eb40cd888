"""Hide effects: draw or check their parameters, and make the declared and the true vehicle.

A hidden effect changes the true vehicle only. The one exception is ``rotor_drag``: the declared vehicle has linear
drag, and where that drag is to be found it is taken out of the declaration.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from benchmarks.undeclared.catalog import EFFECTS, FEATURES, SIZES, UNKNOWN, Params, PlantEffect
from benchmarks.undeclared.vehicle import PlantVehicle

__all__ = ["EFFECTS", "SIZES", "UNKNOWN", "Params", "flight_features", "resolve", "split"]

CAUSES: dict[str, PlantEffect] = {**EFFECTS, **UNKNOWN}


def resolve(
    effects: Mapping[str, str | Mapping[str, float]], *, declared: PlantVehicle, seed: int
) -> dict[str, Params]:
    """Return the parameters of each effect: drawn where a size is given, else as given and completed.

    Each effect draws from its own stream, so that its values do not depend on which other effects a case has.

    Raises:
        ValueError: For an unknown effect, size or parameter, or one that is missing.
    """
    return {name: _resolve_one(name, value, declared, seed) for name, value in effects.items()}


def _resolve_one(name: str, value: str | Mapping[str, float], declared: PlantVehicle, seed: int) -> Params:
    if name not in CAUSES:
        raise ValueError(f"no effect {name!r}. Known: {', '.join(CAUSES)}")
    effect = CAUSES[name]
    if isinstance(value, str):
        if value not in SIZES:
            raise ValueError(f"{name}: no size {value!r}. Known: {', '.join(SIZES)}")
        kind, table = (1, EFFECTS) if name in EFFECTS else (5, UNKNOWN)
        rng = np.random.default_rng([seed, kind, list(table).index(name)])
        drawn = effect.draw(rng, rng.uniform(*effect.ranges[value]), declared)
        return {key: float(number) for key, number in drawn.items()}
    if unknown := set(value) - set(effect.params):
        raise ValueError(f"{name}: no parameter {sorted(unknown)}. Known: {', '.join(effect.params)}")
    params = {key: value.get(key, default) for key, default in effect.params.items()}
    for key, number in params.items():
        if number is None or not np.isfinite(number):
            raise ValueError(f"{name}.{key} = {number!r}: must be given and finite")
    return {key: float(number) for key, number in params.items()}


def split(declared: PlantVehicle, params: Mapping[str, Params]) -> tuple[PlantVehicle, PlantVehicle]:
    """Return the vehicle as it will be declared and as it is, for resolved effects."""
    true = declared
    for name, values in params.items():
        true = CAUSES[name].apply(true, values)
    if "rotor_drag" in params:
        declared = replace(declared, linear_drag=np.zeros(3))
    return declared, true


def flight_features(effects: Iterable[str], further: Iterable[str]) -> tuple[str, ...]:
    """Return the features of the flights of a case: those that its effects need, and further ones.

    Raises:
        ValueError: For an unknown feature.
    """
    if unknown := set(further) - set(FEATURES):
        raise ValueError(f"no feature {sorted(unknown)}. Known: {', '.join(FEATURES)}")
    wanted = {*further, *(need for name in effects for need in CAUSES[name].needs)}
    return tuple(feature for feature in FEATURES if feature in wanted)
