"""Gradients through a whole rollout, against finite differences in float64."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, build_model, vehicle_from_config
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.torch_backend import advance_remembering
from tests.physics.vehicles import CEILING, F64, ON_RIGID, SpeedControl, asymmetric_robot, random_state

NUDGE, DT = 1e-6, 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "euler" else pytest.mark.slow) for name in INTEGRATORS]
)
def test_gradients_of_a_rollout_with_every_effect(name: str) -> None:
    """Of the final state for commands, initial velocity and the parameters of all effects, in their scales. Two
    environments, of which neither depends on the other. Each number is nudged in a copy of its own, all in one batch."""
    robot, state = asymmetric_robot(), random_state(2)
    state = replace(state, position=state.position + 4.0)  # above the ground
    effects = [EFFECTS.get(effect) for effect in ON_RIGID]
    scales, params = [], []
    for effect in effects:
        scale = torch.tensor([p.scale for p in effect.parameters], dtype=F64)
        more = torch.tensor([0.5 * (p.kind == "number") for p in effect.parameters], dtype=F64)
        scales.append(scale)
        params.append((torch.tensor(effect.neutral(robot), dtype=F64) / scale + more).expand(2, -1))
    inputs = (1.2 * state.rotor_speed, state.lin_vel, *params)
    widths = [rows.shape[1] for rows in inputs]

    def final(numbers: Tensor) -> Tensor:
        command, velocity, *rows = numbers.split(widths, dim=1)
        vehicle = vehicle_from_config(robot, num_envs=len(numbers), dtype=F64)
        given = [(effect, scale * row) for effect, scale, row in zip(effects, scales, rows, strict=True)]
        model = build_model(vehicle, given, ceiling_height=CEILING)
        first = BodyState(**{key: rows.repeat(len(numbers) // 2, 1) for key, rows in vars(state).items()})
        random = Randomness(len(numbers))
        random.environment.copy_(torch.arange(2, dtype=torch.int32).repeat(len(numbers) // 2))
        memory = make_memory(model, DT, random=random)
        first = replace(first, lin_vel=velocity)
        end, _ = advance_remembering(model, INTEGRATORS[name], SpeedControl(), first, command, DT, 5, memory)
        return torch.cat(end.tensors(), dim=-1)

    numbers = torch.cat(inputs, dim=1).requires_grad_()
    end = final(numbers)
    result = torch.stack([torch.autograd.grad(value, numbers, retain_graph=True)[0] for value in end.flatten()])
    with torch.no_grad():
        nudges = NUDGE * torch.eye(sum(widths), dtype=F64).unsqueeze(1)
        up, down = (final((numbers + sign * nudges).flatten(0, 1)) for sign in (1.0, -1.0))
    slopes = ((up - down) / (2.0 * NUDGE)).view(-1, *end.shape)
    expected = torch.zeros(*end.shape, *numbers.shape, dtype=F64)
    for env in range(2):
        expected[env, :, env] = slopes[:, env].T
    torch.testing.assert_close(result, expected.flatten(0, 1), atol=1e-5, rtol=1e-4)
