"""Replay of the memory of effects along flights (``Effect.replay``). Letters: T rows, M memory values, R rotors."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from aerial_gym.physics.effect_cache import EffectCache
from aerial_gym.physics.effects import Effect, RotorSensorEffect
from aerial_gym.physics.effects.by_kind import EffectsByKind
from aerial_gym.physics.effects.track import FlightTrack
from aerial_gym.physics.model import Model
from aerial_gym.physics.vehicle import Vehicle
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.replay.rotors import true_rotor_speed
from aerial_gym.sim2real.predict.rows.batches import vehicle_of_row


def effects_with_memory(effects: EffectsByKind) -> Iterator[tuple[Effect, Tensor]]:
    """Yield effects, with parameters, whose memory ``Effect.replay`` computes: not of commands, loads or random wind."""
    for effect, params in effects.forces:
        if effect.replayed and effect.remembers:
            yield effect, params


def make_flight_track(
    flight: Flight, vehicle: Vehicle, rotor_speed: Tensor, step: float, *, settled: float = 1.0
) -> FlightTrack:
    """Return the track that drives memory along a flight; arguments as the fields of ``Track``."""
    stands = flight.on_ground is not None and bool(flight.on_ground[0])
    return FlightTrack(vehicle=vehicle, rotor_speed=rotor_speed, step=step, begins_on_ground=stands, settled=settled)


def replay_memory(
    model: Model,
    flights: Sequence[Flight],
    speeds: Sequence[Array | None] | None,
    answers: EffectCache[FlightTrack],
    *,
    settled: float,
) -> dict[str, list[Tensor]]:
    """Return the memory of effects on rotors and body in every log row of each flight, (T, M), by effect.

    ``speeds``: rotor speeds from the commands [rad/s], (T, R), for flights without measured ones. ``answers``: stored
    results. ``settled``: initial angle of soft arms as a share of their rest angle, if a log begins in the air.
    """
    effects = list(effects_with_memory(model.effects))
    if not effects:
        return {}
    vehicle, tracks = vehicle_of_row(model.vehicle, 0), list[FlightTrack]()
    sensors = [(effect, params[:1]) for effect, params in model.effects[RotorSensorEffect]]
    for flight, led in zip(flights, speeds or [None] * len(flights), strict=True):
        speed = led if flight.rotor_speed is None else flight.rotor_speed
        assert speed is not None
        true = true_rotor_speed(torch.from_numpy(speed), () if flight.rotor_speed is None else sensors)
        tracks.append(make_flight_track(flight, vehicle, true, 1.0 / flight.rate, settled=settled))
    return {
        effect.name: [answers.ask(effect.replay, track, params[:1], place=k) for k, track in enumerate(tracks)]
        for effect, params in effects
    }
