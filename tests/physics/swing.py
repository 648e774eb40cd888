"""A vehicle with effects that remember, flown substep by substep with its memory in the open."""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate
from aerial_gym.physics import INTEGRATORS, BodyState
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.physics.integrators import MassState, to_body_state, to_mass_state
from aerial_gym.physics.memory import Memory, begin_substep, end_substep, link_state_of_load, make_memory
from aerial_gym.physics.model import Model

MASS, LENGTH, DAMPING = 0, 1, 2
"""Places of the parameters of the payload."""


def fly_remembering(
    model: Model, memory: Memory, state: BodyState, commands: list[Tensor], dt: float, integrator: str = "rk4"
) -> tuple[BodyState, Memory]:
    for command in commands:
        now, followed, memory = begin_substep(model, memory, state.rotor_speed, command, dt)
        after = INTEGRATORS[integrator](
            now, to_mass_state(model, state, link_state_of_load(model, memory)), followed, dt
        )
        state, memory = to_body_state(model, after), end_substep(memory, after.load)
    return state, memory


def fly_load(
    model: Model, state: BodyState, load: Tensor, span: float, steps: int, integrator: str = "rk4"
) -> tuple[BodyState, Tensor]:
    memory = replace(make_memory(model, span / steps), numbers=load)
    end, memory = fly_remembering(model, memory, state, [state.rotor_speed] * steps, span / steps, integrator)
    return end, link_state_of_load(model, memory)


def momentum_energy(model: Model, state: BodyState, load: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    vehicle, params = model.vehicle, model.effects[LoadEffect][0][1]
    mass, hung, length = vehicle.mass[:, None], params[:, MASS, None], params[:, LENGTH, None]
    com: MassState = to_mass_state(model, state)
    position, velocity = state.position + length * load[:, :3], state.lin_vel + length * load[:, 3:]
    spin = (vehicle.inertia @ state.ang_vel.unsqueeze(-1)).squeeze(-1)
    momentum = mass * com.lin_vel + hung * velocity
    angular = mass * torch.linalg.cross(com.position, com.lin_vel) + hung * torch.linalg.cross(position, velocity)
    kinetic = 0.5 * (mass * com.lin_vel**2 + hung * velocity**2 + state.ang_vel * spin).sum(-1)
    potential = model.gravity * (mass * com.position + hung * position)[:, 2]
    return momentum, angular + quat_rotate(state.attitude, spin), kinetic + potential
