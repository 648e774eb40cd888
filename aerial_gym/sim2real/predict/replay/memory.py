"""What effects remember along flights: each replays itself (``Effect.replay``). Letters: T rows, M remembered numbers."""

from collections.abc import Iterator

from torch import Tensor

from aerial_gym.physics.effects import Effect, RotorEffect, WrenchEffect
from aerial_gym.physics.effects.by_kind import EffectsByKind
from aerial_gym.physics.effects.track import Track
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.sim2real.logs.flights import Flight


def remembering(effects: EffectsByKind) -> Iterator[tuple[Effect, Tensor]]:
    """Yield the effects on rotors and body that remember, with their parameters.

    Others are not replayed here: what commands lead to is ``RotorReplay``'s, a load ``LoadReplay``'s, and random wind predicts
    no row.
    """
    for kind in (RotorEffect, WrenchEffect):
        for effect, params in effects[kind]:
            if effect.remembers:
                yield effect, params


def track_of(flight: Flight, vehicle: Vehicle, rotor_speed: Tensor, step: float, *, settled: float = 1.0) -> Track:
    """Return what drives memory along a flight; arguments as the fields of ``Track``."""
    stands = flight.on_ground is not None and bool(flight.on_ground[0])
    return Track(vehicle=vehicle, rotor_speed=rotor_speed, step=step, begins_on_ground=stands, settled=settled)
