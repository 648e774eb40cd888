"""A learned residual: its network against numpy, its bounds, its gradients, and both backends with it."""

from dataclasses import replace
from math import tanh
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.config import dump_yaml
from aerial_gym.config.learned_residual import LayerCfg, LearnedResidualCfg
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import BodyState, TorchBackend, WarpBackend, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.capabilities import require, robot_needs
from aerial_gym.physics.effects import LearnedResidual, WrenchEffect
from aerial_gym.physics.model import Model, robot_effects
from tests.builders import simulation
from tests.physics.vehicles import F64, asymmetric_robot, random_network, random_state

NUM_ENVS = 24
NETWORKS = [random_network(16), random_network(7, 12, seed=1)]


def by_hand(cfg: LearnedResidualCfg, felt: np.ndarray) -> np.ndarray:
    width = len(felt)
    standard = [(felt[i] - cfg.centre[i]) / cfg.scale[i] for i in range(width)]
    square = sum(sum(cfg.whitening[i][j] * standard[j] for j in range(width)) ** 2 for i in range(width))
    s = min(max((4.0 - square) / 3.0, 0.0), 1.0)
    values = [(min(max(felt[i], cfg.low[i]), cfg.high[i]) - cfg.centre[i]) / cfg.scale[i] for i in range(width)]
    for layer in cfg.hidden:
        values = [
            tanh(b + sum(w * v for w, v in zip(row, values, strict=True)))
            for row, b in zip(layer.weights, layer.bias, strict=True)
        ]
    out = [
        b + sum(w * v for w, v in zip(row, values, strict=True))
        for row, b in zip(cfg.output.weights, cfg.output.bias, strict=True)
    ]
    return np.array([s * s * (3.0 - 2.0 * s) * min(max(y, -m), m) for y, m in zip(out, cfg.limit, strict=True)])


def one_unit() -> LearnedResidualCfg:
    """Return a network in which force x is ``2 tanh(0.5 vx / 4)`` N, up to 0.4 N, for |vx| up to 2 m/s."""
    zeros = (0.0,) * 6
    return LearnedResidualCfg(
        low=(-2.0,) * 7, high=(2.0,) * 7, centre=(0.0,) * 7, scale=(4.0,) * 7,
        whitening=tuple(tuple(1.0 if i == j else 0.0 for j in range(7)) for i in range(7)),
        hidden=(LayerCfg(weights=((0.5, *zeros),), bias=(0.0,)),),
        output=LayerCfg(weights=((2.0,), *((0.0,),) * 5), bias=zeros), limit=(0.4, *(0.0,) * 5), source="test",
    )  # fmt: skip


def make_model(robot: RobotCfg, dtype: torch.dtype, *, num_envs: int = NUM_ENVS) -> Model:
    effects = robot_effects(robot, num_envs=num_envs, device=torch.device("cpu"), dtype=dtype)
    return build_model(vehicle_from_config(robot, num_envs=num_envs, dtype=dtype), effects)


def network_inputs(model: Model, state: BodyState) -> np.ndarray:
    """Return the inputs (E, 7) in a state: body velocity of the centre of mass, rate, mean squared rotor speed."""
    x, y, z, w = state.attitude.double().unbind(-1)
    rotation = torch.stack((
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ), dim=-1).view(-1, 3, 3)  # fmt: skip
    velocity = torch.einsum("eij,ei->ej", rotation, state.lin_vel.double())
    velocity = velocity + torch.linalg.cross(state.ang_vel.double(), model.vehicle.com.double())
    square = (state.rotor_speed.double() ** 2).mean(dim=-1, keepdim=True)
    return torch.cat((velocity, state.ang_vel.double(), square), dim=-1).numpy()


@pytest.mark.parametrize(
    ("velocity", "force"),
    [
        (1.0, 2.0 * tanh(0.125)),
        (-1.0, -2.0 * tanh(0.125)),
        (1.9, 0.4),  # limited
        (4.0, 0.4),  # the input is held, the output limited; on the edge of the training data
        (8.0, 0.0),  # twice as far
        (40.0, 0.0),
        (4.0 * 2.5**0.5, 0.4 * 0.5),  # q = 2.5: half way from 1 to 4
    ],
)
def test_one_unit_has_its_closed_form(velocity: float, force: float) -> None:
    felt = torch.zeros(1, 7, dtype=F64)
    felt[0, 0] = velocity
    expected = torch.tensor([[force, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=F64)
    torch.testing.assert_close(LearnedResidual(one_unit()).evaluate(felt), expected, atol=1e-15, rtol=1e-12)


@pytest.mark.parametrize("cfg", NETWORKS)
def test_force_and_torque_are_those_by_hand(cfg: LearnedResidualCfg) -> None:
    """``accelerations`` with the residual minus without are F / m and J^-1 tau, about the centre of mass."""
    robot = replace(asymmetric_robot(), learned_residual=cfg)
    state = random_state(NUM_ENVS, seed=3)
    model, bare = make_model(robot, F64), make_model(replace(robot, learned_residual=None), F64)
    expected = np.stack([by_hand(cfg, row) for row in network_inputs(model, state)])
    assert np.abs(expected).min(axis=1).max() > 0.0
    more, less = accelerations(model, state), accelerations(bare, state)
    turning = more.ang_acc - less.ang_acc
    force = 0.8 * (more.specific_force - less.specific_force + torch.linalg.cross(turning, model.vehicle.com))
    torque = torch.einsum("eij,ej->ei", model.vehicle.inertia, turning)
    np.testing.assert_allclose(force.numpy(), expected[:, :3], atol=1e-13)
    np.testing.assert_allclose(torque.numpy(), expected[:, 3:], atol=1e-13)


@pytest.mark.parametrize("integrator", [pytest.param("euler", marks=pytest.mark.slow), "rk4"])
@pytest.mark.parametrize("cfg", NETWORKS)
def test_backends_agree_with_it_and_without_a_share_it_does_nothing(cfg: LearnedResidualCfg, integrator: str) -> None:
    """The fused flight of 0.1 s is within round-off of float64; environments with the share 0 fly as if it were not there.
    Networks are constants of the kernel: one after the other in a process, each must come with its own."""
    robot = replace(asymmetric_robot(), learned_residual=cfg)
    ends = []
    for backend, dtype in ((TorchBackend(), F64), (WarpBackend(), torch.float32)):
        for vehicle in (robot, replace(robot, learned_residual=None)):
            model = make_model(vehicle, dtype)
            for _, share in model.effects[WrenchEffect]:
                share[:4] = 0.0
            law = make_controller(CONTROLLERS.get("rotor_speed_control"), model.vehicle, 9.81)
            state = BodyState(**{name: t.to(dtype, copy=True) for name, t in vars(random_state(NUM_ENVS)).items()})
            backend.allocate(model, law, integrator=integrator)
            backend.step(state, torch.full((NUM_ENVS, 4), 780.0, dtype=dtype), 0.005, 20)
            ends.append(state)
    exact, exact_bare, fused, fused_bare = ends
    for name, truth in vars(exact).items():
        size = 1.0 + truth.abs().max()
        assert ((getattr(fused, name) - truth).abs().max() / size) < 5e-6, name
    assert (exact.lin_vel - exact_bare.lin_vel).abs().amax(dim=1)[4:].min() > 1e-3
    for state, bare in ((exact, exact_bare), (fused, fused_bare)):
        torch.testing.assert_close(state.lin_vel[:4], bare.lin_vel[:4], atol=0.0, rtol=0.0)


def test_gradients_are_those_of_finite_differences() -> None:
    learned = LearnedResidual(random_network(16))
    draw = torch.randn(12, 7, dtype=F64, generator=torch.Generator().manual_seed(1))
    felt = torch.tensor(learned.cfg.centre, dtype=F64) + torch.tensor(learned.cfg.scale, dtype=F64) * 1.3 * draw
    far = learned.distance(felt)
    assert ((far > 1.0) & (far < 4.0)).any()
    assert (far < 1.0).any()
    assert torch.autograd.gradcheck(learned.evaluate, felt.requires_grad_())

    model = make_model(replace(asymmetric_robot(), learned_residual=learned.cfg), F64, num_envs=2)
    backend = TorchBackend()
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), model.vehicle, 9.81)
    backend.allocate(model, law, integrator="rk4")
    state = random_state(2, seed=4)

    def fly(lin_vel: torch.Tensor, ang_vel: torch.Tensor) -> tuple[torch.Tensor, ...]:
        start = replace(state, lin_vel=lin_vel, ang_vel=ang_vel)
        after = backend.advance(start, state.rotor_speed, 0.01, 2)
        return after.lin_vel, after.ang_vel

    assert torch.autograd.gradcheck(fly, (state.lin_vel.requires_grad_(), state.ang_vel.requires_grad_()))


@pytest.mark.parametrize("backend", ["torch", "warp"])
def test_a_robot_file_with_it_flies(tmp_path: Path, backend: str) -> None:
    path = tmp_path / "robot.yaml"
    robot = replace(asymmetric_robot(), learned_residual=random_network(16))
    path.write_text(dump_yaml(robot), encoding="utf-8")
    result = load_robot(path)
    assert result == robot
    ends = []
    for flown in (result, replace(result, learned_residual=None)):
        env = simulation(flown, "rotor_speed_control", backend=backend)
        env.reset()
        if flown is result:
            env.gtd["effect_learned_residual"][1] = 0.0
            env.robot_manager.refresh_model()
        for _ in range(20):
            env.step(torch.full((2, 4), 800.0))
        ends.append(env.gtd["robot_linvel"].clone())
    moved = (ends[0] - ends[1]).norm(dim=1)
    assert moved[0] > 1e-3
    assert moved[1] == 0.0


def _replace_fields(**changes: object) -> LearnedResidualCfg:
    return replace(one_unit(), **changes)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: _replace_fields(scale=(0.0,) * 7), r"LearnedResidualCfg.scale = .*: must be > 0"),
        (lambda: _replace_fields(low=(3.0,) * 7), r"low = .* must not exceed high"),
        (lambda: _replace_fields(high=(3.0,) * 6), r"LearnedResidualCfg.high = .*: needs 7 entries, one per input"),
        (lambda: _replace_fields(centre=(float("nan"),) * 7), r"LearnedResidualCfg.centre = .*: must be finite"),
        (lambda: _replace_fields(whitening=((1.0,),) * 7), r"whitening = .*: needs 7 rows of 7 numbers"),
        (lambda: _replace_fields(limit=(1.0,) * 5), r"6 outputs with 5 limits: needs 6 of each"),
        (lambda: _replace_fields(limit=(-1.0,) * 6), r"LearnedResidualCfg.limit = .*: must be >= 0"),
        (lambda: _replace_fields(hidden=()), r"LearnedResidualCfg.hidden = .*: needs at least one layer"),
        (
            lambda: _replace_fields(hidden=(random_network(7).hidden[0],)),
            r"layer 2 takes 1 numbers, the one before gives 7",
        ),
        (lambda: LayerCfg(weights=((1.0, 2.0), (1.0,)), bias=(0.0, 0.0)), r"needs rows of one length"),
        (lambda: LayerCfg(weights=((1.0,),), bias=(0.0, 0.0)), r"and a bias for each"),
        (lambda: LayerCfg(weights=((float("inf"),),), bias=(0.0,)), r"LayerCfg.weights = .*: must be finite"),
    ],
)
def test_bad_networks_are_refused(make, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


def test_a_backend_that_does_not_know_it_refuses() -> None:
    robot = replace(asymmetric_robot(), learned_residual=one_unit())
    backend = WarpBackend()
    assert "learned_residual" in (backend.capabilities.effects or ())

    class Older(WarpBackend):
        capabilities = replace(backend.capabilities, effects=())

    with pytest.raises(CapabilityError, match="cannot run effect 'learned_residual'"):
        require(Older(), robot_needs(robot, torch.device("cpu")))
