"""Forces brought into the band one by one add up to the whole; noise told from spectra."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics import BodyState, accelerations, build_model, condition_in, vehicle_from_config
from aerial_gym.physics.effects import FluidEffect, LoadEffect
from aerial_gym.physics.rigid_body import (
    add_fluid_contributions,
    condition_at_origin,
    force_breakdown,
    load_suspension,
    suspension_pull,
)
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects
from aerial_gym.sim2real.predict.rows.band_response import BandResponse
from aerial_gym.sim2real.predict.rows.batches import expand_model
from aerial_gym.sim2real.predict.rows.dataset import Dataset
from aerial_gym.sim2real.predict.rows.rotor_estimate import estimate_rotors
from aerial_gym.sim2real.predict.rows.spectra import filter_by_gain, noise_level, power_density
from tests.unit.sim2real.flat_flights import ROBOT, flight, uniform_flight

BAND = 10.0
WATER = {"added_mass": (0.3, 0.2, 0.4)}


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"rotor_drag": (0.2, 0.1, 0.05), "com_offset": (0.01, -0.02, 0.005), "inertia_error": (1.2, 0.9, 1.3)},
        {
            "thrust_coefficient": (1.1,),
            "axial_inflow": (2e-4,),
            "weak_motor": (2.0, 0.8),
            "motor_tilt": (1.0, 0.1, -0.05),
            "h_force_flapping": (1e-5, 1e-6),
            "rotor_inertia": (1e-6,),
            "rotor_drag": (0.2, 0.1, 0.05),
            "com_offset": (0.01, -0.02, 0.005),
        },
        {"slung_payload": (0.05, 0.5, 0.01), "payload_mass": (0.1,), "com_offset": (0.01, -0.02, 0.005)},
        {**WATER, "quadratic_drag": (0.1, 0.2, 0.1)},
    ],
    ids=["nothing", "body", "rotors", "load", "fluid"],
)
def test_the_band_of_a_sum_is_the_sum_of_the_bands(effects: dict[str, tuple[float, ...]], tmp_path: Path) -> None:
    """Against the accelerations of all forces together in every row, low-passed: to rounding, 1e-11 of 10 m/s²."""
    logs = {"3": flight(3, seconds=4.0), "5": flight(5, seconds=5.0, drag=0.2)}
    flights = [uniform_flight(log, tmp_path, name) for name, log in logs.items()]
    rotors = estimate_rotors(ROBOT, flights, BAND)
    data = Dataset(flights, rotors=rotors, bandwidth=BAND, channels=find_channels(flights), every_row=False)
    count = data.speed.shape[0]
    vehicle = vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64)
    params = ModelParams(effects={name: np.array(values) for name, values in effects.items()})
    model = expand_model(build_model(vehicle, expand_effects(params, 1)), count)
    state = BodyState(rotor_speed=data.speed, **data.state)
    condition, link = condition_in(model, state, torch.zeros_like(data.speed)), None
    if model.effects[LoadEffect]:
        swing = torch.linspace(0.0, 6.0, count, dtype=torch.float64)
        x = 0.3 * swing.sin()
        link = torch.stack([x, 0.0 * swing, -(1.0 - x**2).sqrt()] + [0.1 * swing] * 3, 1)
    whole = accelerations(model, state, load=link, condition=condition)
    acting = add_fluid_contributions(model, condition, force_breakdown(model, condition))
    if link is not None:
        alone = accelerations(replace(model, effects=model.effects.exclude(LoadEffect)), state, condition=condition)
        gravity = model.gravity * torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        free_fall = quat_rotate(state.attitude, alone.specific_force) - gravity
        origin = torch.zeros_like(model.vehicle.com)
        suspension = load_suspension(model, state.attitude, free_fall, origin)
        force, torque, _ = suspension_pull(model, state.attitude, suspension, link, origin)
        pull = torch.cat((quat_rotate_inverse(state.attitude, force), torque), dim=1)
        acting.wrenches.append(("load", pull))
    band = BandResponse(data)
    result = band.accelerations_in_band(model, data.speed, acting)
    # The lever of the accelerometer turns as measured.
    force = whole.specific_force + torch.linalg.cross(whole.ang_acc - data.ang_acc, model.vehicle.com)
    for actual, rows in ((result.specific_force, force), (result.ang_acc, whole.ang_acc)):
        for index, (span, kept) in enumerate(zip(data.spans, data.kept_spans, strict=True)):
            rate, stride = flights[index].rate / data.stride[index], data.stride[index]
            slow = lowpass(rows[span].numpy(), rate, BAND)[data.kept[index] // stride]
            np.testing.assert_allclose(actual[kept].numpy(), slow, rtol=0.0, atol=1e-10)
    assert float(result.ang_acc.abs().max()) > 1.0
    if not model.effects[LoadEffect] and not model.effects[FluidEffect]:
        hubs = condition_at_origin(model, state, torch.zeros_like(data.speed))
        parts = force_breakdown(model, condition, apart=True, hubs=hubs)
        apart = band.accelerations_in_band(model, data.speed, parts, about=torch.zeros(3, dtype=torch.float64))
        torch.testing.assert_close(apart.specific_force, result.specific_force, rtol=0.0, atol=1e-10)
        torch.testing.assert_close(apart.ang_acc, result.ang_acc, rtol=0.0, atol=1e-10)
    again = band.accelerations_in_band(model, data.speed.clone(), acting)
    torch.testing.assert_close(again.specific_force, result.specific_force, rtol=0.0, atol=0.0)


def test_the_noise_is_that_of_the_quietest_octave() -> None:
    frequency = np.arange(0.0, 100.0, 0.5)
    density = np.where(frequency < 20.0, 50.0, np.where(frequency > 45.0, 9.0, 2.0))[:, None]
    result = noise_level(frequency, density, 10.0, 200.0)
    assert result[0] == pytest.approx(2.0)
    assert result[1] == 30.0
    assert noise_level(frequency, density, 40.0, 200.0) is None  # no octave between 60 and 90 Hz


def test_white_noise_is_level_and_its_power_is_its_variance() -> None:
    """Down to the lowest lines, from which a straight line is taken: 400 s of it, within four deviations of a mean."""
    values = 3.0 * np.random.default_rng(0).standard_normal((40_000, 2))
    frequency, density = power_density(values, 100.0)
    segments = 9.0 / 11.0 * 2.0 * 400.0 / 2.0
    assert density[1:-1] == pytest.approx(9.0 / 50.0, rel=5.0 / np.sqrt(segments))
    assert density[1:4].mean() == pytest.approx(9.0 / 50.0, rel=4.0 / np.sqrt(6.0 * segments))
    assert (density.sum(axis=0) * frequency[1]) == pytest.approx(9.0, rel=0.03)


def test_a_filter_keeps_the_phase() -> None:
    """A wave of 3 Hz at a gain that falls by 0.1 from each Hz to the next."""
    time = np.arange(2_000) / 100.0
    wave = np.sin(2.0 * np.pi * 3.0 * time)[:, None]
    frequency = np.arange(0.0, 51.0)
    result = filter_by_gain(wave, frequency, np.maximum(0.0, 1.0 - 0.1 * frequency)[:, None], 100.0)
    assert result[200:-200] == pytest.approx(0.7 * wave[200:-200], abs=0.01)
