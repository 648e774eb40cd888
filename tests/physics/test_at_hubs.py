"""Forces at hubs do not depend on where the centre of mass is: what ``Effect.at_hubs`` promises, effect by effect."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.physics import EFFECTS, build_model, condition_in, effects_from_config, vehicle_from_config
from aerial_gym.physics.effects import Condition, Effect, RotorEffect, WrenchEffect
from aerial_gym.physics.rigid_body import condition_at_origin
from tests.physics.vehicles import F64, asymmetric_robot, random_state

ROWS = 6
KINDS = {name: EFFECTS.get(name) for name in EFFECTS if isinstance(EFFECTS.get(name), RotorEffect | WrenchEffect)}
AT_HUBS = [name for name, one in KINDS.items() if one.at_hubs]
OF_CENTRE = ["rotor_drag", "quadratic_drag"]


def evaluate_effect(effect: Effect, condition: Condition) -> Tensor:
    generator = torch.Generator().manual_seed(3)
    scales = torch.tensor([parameter.scale for parameter in effect.parameters], dtype=F64)
    shares = 0.5 + torch.rand(scales.numel() + len(effect.fresh_memory(4)), generator=generator, dtype=F64)
    shares[: scales.numel()] *= scales
    params = shares.expand(ROWS, -1)
    return effect.thrust(condition, params) if isinstance(effect, RotorEffect) else effect.wrench(condition, params)


def both_conditions() -> tuple[Condition, Condition]:
    """Return a condition about a centre of mass and about the origin, in a wind that depends on the height."""
    wind = {"wind_shear": {"x": 3.0, "y": -2.0, "z_ref": 2.0, "exponent": 0.3}}
    effects = effects_from_config(wind, num_envs=ROWS, device=torch.device("cpu"), dtype=F64)
    vehicle = vehicle_from_config(asymmetric_robot(com=(0.03, -0.04, 0.05)), num_envs=ROWS, dtype=F64)
    other = torch.tensor([[0.1, 0.2, 8.0]], dtype=F64).expand(ROWS, -1)
    state = random_state(ROWS)
    state = replace(state, position=state.position + torch.tensor([0.0, 0.0, 4.0], dtype=F64))
    ceiling = float(state.position[:, 2].max()) + 0.3
    model = build_model(vehicle, effects, ceiling_height=ceiling, other_position=other)
    spin_up = torch.linspace(-300.0, 400.0, ROWS * 4, dtype=F64).view(ROWS, 4)
    return condition_in(model, state, spin_up), condition_at_origin(model, state, spin_up)


@pytest.mark.parametrize("name", AT_HUBS)
def test_forces_at_hubs_are_the_same_for_every_centre_of_mass(name: str) -> None:
    of_centre, of_origin = both_conditions()
    result, there = evaluate_effect(EFFECTS.get(name), of_centre), evaluate_effect(EFFECTS.get(name), of_origin)
    if result.shape[1] == 6:
        com = of_centre.vehicle.com
        there = torch.cat((there[:, :3], there[:, 3:] - torch.linalg.cross(com, there[:, :3])), dim=1)
    assert float(result.abs().max()) > 1e-6
    torch.testing.assert_close(result, there, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("name", OF_CENTRE)
def test_forces_at_the_centre_of_mass_are_not(name: str) -> None:
    """Else these effects could say the same of themselves, and the test above would see nothing."""
    effect = EFFECTS.get(name)
    assert not effect.at_hubs
    of_centre, of_origin = both_conditions()
    result, there = evaluate_effect(effect, of_centre), evaluate_effect(effect, of_origin)
    assert float((result - there).abs().max()) > 1e-3 * float(result.abs().max())


def test_a_condition_at_the_origin_does_not_depend_on_the_centre_of_mass() -> None:
    """Bit for bit, so that answers stand: without a wind, and in one that is the same everywhere."""
    state = random_state(ROWS)
    still = torch.zeros_like(state.rotor_speed)
    for wind in ({}, {"constant_wind": {"x": 3.0, "y": -2.0, "z": 0.5}}):
        effects = effects_from_config(wind, num_envs=ROWS, device=torch.device("cpu"), dtype=F64)
        first, second = (
            condition_at_origin(
                build_model(vehicle_from_config(asymmetric_robot(com=com), num_envs=ROWS, dtype=F64), effects),
                state,
                still,
            )
            for com in ((0.0, 0.0, 0.0), (0.03, -0.04, 0.05))
        )
        for seen in ("air_velocity", "hub_velocity", "edgewise_velocity", "hub_altitude", "lever", "rotor_thrust"):
            assert torch.equal(getattr(first, seen), getattr(second, seen)), seen
