"""Gradients of a rollout through Warp's tape against those of the float64 torch backend (held to gradcheck elsewhere)."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError
from aerial_gym.physics import EFFECTS, BodyState, TorchBackend, WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.effects import LearnedResidual
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import CEILING, ON_RIGID, asymmetric_robot, random_network, random_state, strong_effects

NUM_ENVS, DT, SUBSTEPS = 3, 0.01, 5
RELATIVE = 2e-5
"""Of the largest entry: some 200 units in the last place of float32, for some thousand operations."""


OVERRULED = "motor_time_constant"
"""Replaced by what motor_asymmetry says."""


def gradients(backend, dtype: torch.dtype, controller: str, integrator: str) -> dict[str, Tensor]:
    """Return the gradients of a generic function of the state after a rollout, by what they are taken for."""
    robot = asymmetric_robot()
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
    law = make_controller(CONTROLLERS.get(controller), vehicle, 9.81, dt=DT)
    mass = vehicle.mass.clone().requires_grad_()
    inertia = vehicle.inertia.clone().requires_grad_()
    leaves = {"mass": mass, "inertia": inertia}
    known = {name: EFFECTS.get(name) for name in ON_RIGID if name != OVERRULED}
    names = [name for name, effect in known.items() if effect.acts_on != "sensor" and not effect.remembers]
    effects = [(effect, rows.requires_grad_()) for effect, rows in strong_effects(names, robot, NUM_ENVS, dtype=dtype)]
    leaves |= {effect.name: rows for effect, rows in effects}
    leaves["learned_residual"] = torch.full((NUM_ENVS, 1), 0.8, dtype=dtype).requires_grad_()
    effects.append((LearnedResidual(random_network(16), dtype=dtype), leaves["learned_residual"]))
    start = {k: v.to(dtype).requires_grad_() for k, v in vars(random_state(NUM_ENVS, seed=2)).items()}
    with (
        torch.no_grad()
    ):  # the first one upright near the ceiling, the last one near the ground: within reach of every law
        start["position"][:, 2] = torch.tensor([CEILING - 1.0, 4.0, 1.0], dtype=dtype)
        start["attitude"][0] = torch.tensor([0.1, 0.3, 0.3, 0.9], dtype=dtype)
    leaves |= start
    g = torch.Generator().manual_seed(0)
    action = torch.rand(NUM_ENVS, 4, dtype=torch.float64, generator=g).to(dtype)
    action = 700.0 + 100.0 * action if controller == "rotor_speed_control" else 0.2 * action
    leaves["action"] = action.requires_grad_()
    model = build_model(replace(vehicle, mass=mass, inertia=inertia), effects, ceiling_height=CEILING)
    backend.allocate(model, law, integrator=integrator)
    end = backend.advance(BodyState(**start), action, DT, SUBSTEPS)
    weights = [torch.rand(t.shape, dtype=torch.float64, generator=g).to(dtype) for t in end.tensors()]
    scales = (1.0, 1.0, 1.0, 1.0, 1e-3)
    loss = sum((s * w * t).sum() for s, w, t in zip(scales, weights, end.tensors(), strict=True))
    result = dict(zip(leaves, torch.autograd.grad(loss, list(leaves.values())), strict=True))
    unit, slope = start["attitude"].detach(), result["attitude"]
    result["attitude"] = slope - (slope * unit).sum(-1, keepdim=True) * unit  # off the unit sphere there is no physics
    return result


@pytest.mark.parametrize(
    ("controller", "integrator"),
    [("lee_velocity_control", "euler"), pytest.param("rotor_speed_control", "rk4", marks=pytest.mark.slow)],
)
def test_gradients_agree_with_torch(controller: str, integrator: str) -> None:
    exact = gradients(TorchBackend(), torch.float64, controller, integrator)
    single = gradients(TorchBackend(), torch.float32, controller, integrator)
    taped = gradients(WarpBackend(differentiable=True), torch.float32, controller, integrator)
    for name, truth in exact.items():
        size = truth.abs().max()
        allowed = 4.0 * (single[name] - truth).abs().max() / size + RELATIVE
        error = (taped[name] - truth).abs().max() / size
        assert error <= allowed, f"{name}: {error:.1e} of {size:.2e}, allowed {allowed:.1e}"
        assert size > 0.0, name


@pytest.mark.parametrize("backend", [TorchBackend(), WarpBackend(differentiable=True)], ids=["torch", "warp"])
def test_gradients_stay_finite_where_rotors_are_told_to_stop(backend) -> None:
    """The speed is the root of a thrust, whose slope is infinite at 0: times the 0 of the limit NaN. There is no slope."""
    robot = ROBOTS.get("base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS)
    law = make_controller(CONTROLLERS.get("lee_attitude_control"), vehicle, 9.81, dt=DT)
    backend.allocate(build_model(vehicle), law, integrator="euler")
    state = BodyState(**{name: rows.float() for name, rows in vars(random_state(NUM_ENVS, seed=2)).items()})
    action = torch.tensor([[-1.0, 0.0, 0.0, 0.0]]).repeat(NUM_ENVS, 1).requires_grad_()
    end = backend.advance(state, action, DT, SUBSTEPS)
    (slope,) = torch.autograd.grad(sum(rows.float().sum() for rows in end.tensors()), action)
    assert bool(slope.isfinite().all())


def test_without_gradients_the_rollout_is_that_of_step() -> None:
    robot = asymmetric_robot()
    vehicle = vehicle_from_config(robot, num_envs=2)
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
    start = BodyState(**{k: v.float() for k, v in vars(random_state(2)).items()})
    ends = []
    for backend in (WarpBackend(), WarpBackend(differentiable=True)):
        backend.allocate(build_model(vehicle), law, integrator="rk4")
        ends.append(backend.advance(start, torch.full((2, 4), 2.0), 0.01, 10))
        stepped = BodyState(**{k: v.clone() for k, v in vars(start).items()})
        backend.step(stepped, torch.full((2, 4), 2.0), 0.01, 10)
        assert torch.equal(stepped.position, ends[-1].position)
    for name, tensor in vars(ends[0]).items():
        torch.testing.assert_close(getattr(ends[1], name), tensor, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", [name for name in EFFECTS.names() if EFFECTS.get(name).remembers])
def test_a_differentiable_rollout_refuses_effects_with_memory(name: str) -> None:
    robot, effect = asymmetric_robot(), EFFECTS.get(name)
    vehicle = vehicle_from_config(robot, num_envs=2)
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
    model = build_model(vehicle, [(effect, torch.tensor(effect.neutral(robot)).expand(2, -1))])
    backend = WarpBackend(differentiable=True)
    assert name not in (backend.capabilities.effects or ())
    with pytest.raises(CapabilityError, match=f"cannot run effect '{name}', which has memory. Use backend 'torch'"):
        backend.allocate(model, law, integrator="rk4")
