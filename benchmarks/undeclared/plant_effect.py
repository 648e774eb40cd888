"""What a hidden effect is: parameters, ranges of three sizes, how to draw it and how it changes the vehicle."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.undeclared.vehicle import NEUTRAL, PlantVehicle

SIZES = ("small", "moderate", "large")

Params = dict[str, float]
Ranges = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
Draw = Callable[[np.random.Generator, float, PlantVehicle], Params]


@dataclass(frozen=True, kw_only=True)
class PlantEffect:
    """One named effect."""

    params: dict[str, float | None]  # Parameter names with defaults; None: the value has to be given
    ranges: Ranges  # Ranges of the magnitude for each of ``SIZES``
    draw: Draw  # Parameters from a generator, a magnitude and the declared vehicle
    apply: Callable[[PlantVehicle, Params], PlantVehicle]  # The vehicle that has the effect
    needs: tuple[str, ...] = ("battery",)  # Features of the flights in which it shows
    names: tuple[str, ...] = ()  # Names that state its cause; empty: its own


def field_effect(
    field: str,
    params: dict[str, float | None],
    ranges: Ranges,
    draw: Draw | None = None,
    *,
    drawn: Mapping[str, tuple[float, float]] | None = None,
    needs: tuple[str, ...] = ("battery",),
    law: str = "",
    names: tuple[str, ...] = (),
) -> PlantEffect:
    """Return the effect that sets a field of the vehicle or of its ``extra`` to the parameters, in their order.

    Without ``draw`` the first parameter is the magnitude, and others come from the ranges ``drawn`` or keep their defaults.
    The name of a ``law`` stands before the numbers of a field that can have several laws.
    """

    def set_field(vehicle: PlantVehicle, values: Params) -> PlantVehicle:
        numbers: tuple = (*([law] if law else []), *(values[name] for name in params))
        if hasattr(NEUTRAL, field):
            return set_extra(vehicle, **{field: numbers if len(numbers) > 1 else next(iter(numbers))})
        return replace(vehicle, **{field: np.array(numbers)})

    def draw_params(rng: np.random.Generator, size: float, _: PlantVehicle) -> Params:
        first, *rest = params
        further = {name: rng.uniform(*drawn[name]) if drawn and name in drawn else params[name] for name in rest}
        return {first: size, **further}  # type: ignore[dict-item]

    return PlantEffect(
        params=params, ranges=ranges, draw=draw or draw_params, apply=set_field, needs=needs, names=names
    )


def set_extra(vehicle: PlantVehicle, **changes: object) -> PlantVehicle:
    """Return the vehicle with other numbers in ``extra``."""
    return replace(vehicle, extra=replace(vehicle.extra, **changes))  # type: ignore[arg-type]
