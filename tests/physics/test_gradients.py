"""Gradients through a whole rollout, against finite differences in float64."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.physics import EFFECTS, INTEGRATORS, advance, build_model, vehicle_from_config
from tests.physics.test_rigid_body import SpeedControl
from tests.physics.vehicles import CEILING, F64, lopsided_robot, random_state


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "euler" else pytest.mark.slow) for name in INTEGRATORS]
)
def test_gradients_of_a_rollout_with_every_effect(name: str) -> None:
    """gradcheck of the final state for commands, initial velocity and the parameters of all effects, in their scales."""
    robot, state = lopsided_robot(), random_state(2)
    state = replace(state, position=state.position + 4.0)  # above the ground
    vehicle = vehicle_from_config(robot, num_envs=2, dtype=F64)
    effects = [EFFECTS.get(effect) for effect in EFFECTS.names()]
    scales, params = [], []
    for effect in effects:
        scale = torch.tensor([p.scale for p in effect.parameters], dtype=F64)
        more = torch.tensor([0.5 * (p.kind == "number") for p in effect.parameters], dtype=F64)
        scales.append(scale)
        row = torch.tensor(effect.neutral(robot), dtype=F64) / scale + more
        params.append(row.expand(2, -1).clone().requires_grad_())
    command = (state.rotor_speed * 1.2).requires_grad_()
    velocity = state.lin_vel.clone().requires_grad_()

    def final(command: torch.Tensor, velocity: torch.Tensor, *params: torch.Tensor) -> torch.Tensor:
        rows = [scale * row for scale, row in zip(scales, params, strict=True)]
        model = build_model(vehicle, list(zip(effects, rows, strict=True)), ceiling_height=CEILING)
        start = replace(state, lin_vel=velocity)
        end = advance(model, INTEGRATORS[name], SpeedControl(), start, command, 0.02, 5)
        return torch.cat(end.tensors(), dim=-1)

    assert torch.autograd.gradcheck(final, (command, velocity, *params), eps=1e-6, atol=1e-5, rtol=1e-4)
