"""Reversible, force-mode and slew-limited rotors in the fused kernel against the torch reference, step by step."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.physics import EFFECTS, BodyState, TorchBackend, WarpBackend, build_model, vehicle_from_config
from tests.cross.test_backends import as_type, assert_agreement
from tests.physics.rotor_types import three_type_robot
from tests.physics.vehicles import ON_RIGID, random_state, strong_effects

NUM_ENVS, DT, SUBSTEPS, STEPS = 12, 0.004, 5, 8


def thrusts(step: int) -> Tensor:
    """Return commands [N] that change sign from step to step, some of them beyond the limits and some in the dead band."""
    g = torch.Generator().manual_seed(step)
    drawn = torch.rand(NUM_ENVS, 4, dtype=torch.float64, generator=g) * 16.0 - 6.0
    return torch.where(torch.rand(NUM_ENVS, 4, generator=g) < 0.15, 0.005, drawn)


def by_env(rows: Tensor) -> Tensor:
    """Return rows that differ between environments."""
    steps = torch.linspace(0.9, 1.1, rows.shape[0], dtype=rows.dtype)
    return rows * steps.view(-1, *[1] * (rows.dim() - 1))


def make_model(robot: RobotCfg, dtype: torch.dtype, *, vary: bool, effects: tuple[str, ...]):
    vehicle = declared = vehicle_from_config(robot, num_envs=NUM_ENVS, dtype=dtype)
    if vary:
        kept = {name: rows for name, rows in vehicle.tensors_by_name().items() if name in ("rotor_axis", "rotor_spin")}
        vehicle = replace(vehicle.map_rows(by_env), **kept)
    rows = strong_effects(effects, robot, NUM_ENVS, dtype=dtype)
    return build_model(vehicle, rows, ceiling_height=1.0), declared


def flights(robot, controller, integrator, *, vary=False, effects=(), actions=thrusts) -> list[list[BodyState]]:
    """Return the states after each step of torch in float64 and float32, and of Warp, each from the exact one before."""
    result, exact = [], None
    for backend, dtype in (
        (TorchBackend(), torch.float64),
        (TorchBackend(), torch.float32),
        (WarpBackend(), torch.float32),
    ):
        model, declared = make_model(robot, dtype, vary=vary, effects=effects)
        backend.allocate(model, make_controller(CONTROLLERS.get(controller), declared, 9.81), integrator=integrator)
        state, states = as_type(random_state(NUM_ENVS, seed=5, rotor_speed=300.0), dtype), []
        state.rotor_speed[:, 2] = torch.linspace(-3.0, 5.0, NUM_ENVS)
        state.rotor_speed[:6, 0] *= -1.0
        for step in range(STEPS):
            if exact is not None and step > 0:
                state.copy_(exact[step - 1])
            backend.step(state, actions(step).to(dtype), DT, SUBSTEPS)
            states.append(as_type(state, dtype))
        exact = states if exact is None else exact
        result.append(states)
    return result


@pytest.mark.usefixtures("optimise_kernels")
@pytest.mark.parametrize(("integrator", "vary"), [("euler", True), pytest.param("rk4", False, marks=pytest.mark.slow)])
def test_mixed_rotors_fly_like_torch(integrator: str, vary: bool) -> None:
    """Signs change on the way, slew rates and dead bands act; with every number of its own per environment too."""
    exact, single, fused = flights(three_type_robot(), "no_control", integrator, vary=vary)
    assert min(state.rotor_speed.min() for state in exact) < -3.0
    for step in range(STEPS):
        assert_agreement(exact[step], single[step], fused[step])


def test_effects_on_reversible_rotors_fly_like_torch() -> None:
    names = tuple(n for n in ON_RIGID if {"reversible", "slew"} <= set(EFFECTS.get(n).rotors))
    robot = three_type_robot()
    layout = tuple(replace(m, rotor="reversible" if m.rotor == "force" else m.rotor) for m in robot.mounts.layout)
    robot = replace(
        robot,
        rotors={k: v for k, v in robot.rotors.items() if k != "force"},
        mounts=replace(robot.mounts, layout=layout),
    )
    names = tuple(n for n in names if n != "gusts")
    exact, single, fused = flights(robot, "no_control", "euler", effects=names)
    for step in range(STEPS):
        assert_agreement(exact[step], single[step], fused[step])


def test_gradients_of_mixed_rotors_are_those_of_torch() -> None:
    grads = []
    for backend, dtype in ((TorchBackend(), torch.float64), (WarpBackend(differentiable=True), torch.float32)):
        model, declared = make_model(three_type_robot(), dtype, vary=False, effects=())
        lag = declared.time_constant_up.clone().requires_grad_()
        model = replace(model, vehicle=replace(model.vehicle, time_constant_up=lag))
        backend.allocate(model, make_controller(CONTROLLERS.get("no_control"), declared, 9.81), integrator="euler")
        state = {k: v.to(dtype).requires_grad_() for k, v in vars(random_state(NUM_ENVS, seed=2)).items()}
        action = thrusts(1).to(dtype).requires_grad_()
        end = backend.advance(BodyState(**state), action, DT, 3)
        together = torch.cat([tensor.flatten() for tensor in end.tensors()])
        (together * torch.arange(1.0, together.numel() + 1.0).cos().to(dtype)).sum().backward()
        grads.append([leaf.grad.double() for leaf in (*state.values(), action, lag)])
    for exact, fused in zip(*grads, strict=True):
        assert (fused - exact).abs().max() <= 5e-5 * exact.abs().max().clamp_min(1e-3)
