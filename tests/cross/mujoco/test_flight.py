"""MuJoCo as a backend in free flight against the torch backend, whose Euler steps it repeats. All
in float64."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import BodyCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.errors import CapabilityError
from aerial_gym.math.quaternion import quat_from_euler, quat_to_matrix
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BACKENDS, BodyState, PhysicsBackend, TorchBackend, build_model, vehicle_from_config
from aerial_gym.physics.vehicle import Vehicle, own_rows
from aerial_gym.robots import ROBOTS
from aerial_gym.workloads.measure import torch_threads
from tests.cross.test_backends import as_type, build, random_actions, start_state
from tests.physics.contact_rig import start
from tests.physics.rotor_types import three_type_robot
from tests.physics.vehicles import F64, ON_RIGID, asymmetric_robot, random_state
from tests.repetitions import thin_values

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

ROUND_OFF = 1e-11
"""Both backends take the same steps: in 0.2 s of flight, 50 steps, rounding of 1e-16 grows by less than five digits."""

DT = 0.004


def mujoco_backend() -> PhysicsBackend:
    return BACKENDS.get("mujoco")()


def fly(backend: PhysicsBackend, model, law, state: BodyState, action: Tensor, *, steps: int = 50, dt: float = DT):
    """Return the state after some steps of one substep each; the one that is given stays."""
    backend.allocate(model, law, integrator="euler", random=Randomness(state.num_envs))
    state = as_type(state, state.position.dtype)
    for _ in range(steps):
        backend.step(state, action, dt, 1)
    return state


def assert_same(one: BodyState, other: BodyState, *, bound: float = ROUND_OFF) -> None:
    for name, values in vars(one).items():
        size = 1.0 + values.abs().max().item()
        error = (getattr(other, name) - values).abs().max().item()
        assert error <= bound * size, f"{name}: {error:.1e}"


@pytest.mark.parametrize("name", thin_values([None, *ON_RIGID], 2))
def test_every_effect_flies_as_in_torch(name: str | None) -> None:
    """Each moderately far from neutral, beside drag, which shows wind, on a vehicle with products of inertia."""
    robot, ends = asymmetric_robot(), []
    for backend in (TorchBackend(), mujoco_backend()):
        model, law = build(
            robot, CONTROLLERS.get("no_control"), 5, F64, tuple({"rotor_drag": 0, name: 0} if name else ())
        )
        ends.append(fly(backend, model, law, start_state(model, 5), random_actions(law, model, 5)))
    assert_same(*ends)


@pytest.mark.parametrize("controller", ["lee_position_control", "pid_velocity_control"])
def test_control_laws_fly_as_in_torch(controller: str) -> None:
    robot, ends = ROBOTS.get("tinyprop"), []
    for backend in (TorchBackend(), mujoco_backend()):
        model, law = build(robot, CONTROLLERS.get(controller), 5, F64)
        ends.append(fly(backend, model, law, start_state(model, 5), random_actions(law, model, 5)))
    assert_same(*ends)


def test_rotors_of_all_kinds_fly_as_in_torch() -> None:
    robot, ends = three_type_robot(), []
    for backend in (TorchBackend(), mujoco_backend()):
        vehicle = vehicle_from_config(robot, num_envs=3, dtype=F64)
        law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=DT)
        action = torch.tensor([[2.0, -1.0, 3.0, 0.004]], dtype=F64).repeat(3, 1)
        ends.append(fly(backend, build_model(vehicle), law, random_state(3, rotor_speed=1.0), action))
    assert_same(*ends)


def by_env(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose mass, inertia and centre of mass differ between environments."""
    grow = torch.linspace(0.8, 1.3, vehicle.num_envs, dtype=vehicle.mass.dtype)
    inertia = vehicle.inertia.clone()
    inertia[:, 0, 1] = inertia[:, 1, 0] = 2e-4 * grow
    return replace(
        vehicle, mass=vehicle.mass * grow, inertia=inertia * grow.flip(0)[:, None, None],
        com=vehicle.com * grow[:, None],
    )  # fmt: skip


def test_environments_with_bodies_of_their_own_fly_as_in_torch_and_as_alone() -> None:
    """Mass, inertia and centre of mass by environment. Alone is bit for bit the same, on any number of threads."""
    robot, law_cfg = asymmetric_robot(), CONTROLLERS.get("no_control")
    ends = []
    for backend in (TorchBackend(), mujoco_backend()):
        model, law = build(robot, law_cfg, 6, F64, adjust=by_env)
        state, action = start_state(model, 6), random_actions(law, model, 6)
        with torch_threads(2):
            ends.append(fly(backend, model, law, state, action))
    assert_same(*ends)
    rows = {name: rows[4:5].clone() for name, rows in model.vehicle.tensors_by_name().items()}
    alone = build_model(replace(model.vehicle, **rows))
    declared = vehicle_from_config(robot, num_envs=1, dtype=F64)
    own_law = make_controller(law_cfg, declared, 9.81, dt=DT)
    first = BodyState(**{name: rows[4:5].clone() for name, rows in vars(state).items()})
    with torch_threads(1):
        end = fly(mujoco_backend(), alone, own_law, first, action[4:5])
    for name, values in vars(end).items():
        assert torch.equal(values, getattr(ends[1], name)[4:5]), name


def test_parameters_that_are_written_in_place_are_followed_in_their_rows_alone() -> None:
    """As a masked reset writes them: twice the mass at equal thrust; the other row goes on bit for bit."""
    vehicle = vehicle_from_config(asymmetric_robot(com=(0.0, 0.0, 0.0)), num_envs=2, dtype=F64)
    vehicle = replace(vehicle, mass=own_rows(vehicle.mass))
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81)
    state, speeds = start(2, rotor_speed=800.0), torch.full((2, 4), 800.0, dtype=F64)
    backends = [mujoco_backend(), mujoco_backend()]
    states = [as_type(state, F64) for _ in backends]
    for backend, moved in zip(backends, states, strict=True):
        backend.allocate(build_model(replace(vehicle, mass=vehicle.mass.clone())), law, integrator="euler")
        backend.prepare(DT)
        backend.step(moved, speeds, DT, 1)
    before = states[1].lin_vel.clone()
    (mass,) = (rows for rows in backends[1].parameter_targets() if rows.shape == (2,))
    mass[1] *= 2.0
    for backend, moved in zip(backends, states, strict=True):
        backend.step(moved, speeds, DT, 1)
    assert torch.equal(states[0].lin_vel[0], states[1].lin_vel[0])
    weight = torch.tensor([0.0, 0.0, 9.81], dtype=F64)
    felt, expected = ((moved.lin_vel - before)[1] / DT + weight for moved in (states[1], states[0]))
    assert expected.norm() > 5.0
    torch.testing.assert_close(felt, 0.5 * expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("effect", ["slung_payload", "gusts", "actuation_delay"])
def test_reset_by_mask_forgets_rows_of_the_mask_alone(effect: str) -> None:
    robot, ends = asymmetric_robot(), {}
    for name, reset in (("torch", True), ("mujoco", True), ("mujoco", False)):
        backend = BACKENDS.get(name)()
        model, law = build(robot, CONTROLLERS.get("no_control"), 4, F64, (effect, "rotor_drag"))
        state = start_state(model, 4)
        backend.allocate(model, law, integrator="euler", random=Randomness(4))
        for _ in range(2):
            backend.step(state, random_actions(law, model, 4), DT, 20)
            if reset:
                backend.reset_memory(torch.tensor([True, False, True, False]))
        ends[name, reset] = state
    assert_same(ends["torch", True], ends["mujoco", True])
    for name, values in vars(ends["mujoco", True]).items():
        other = getattr(ends["mujoco", False], name)
        assert torch.equal(values[1::2], other[1::2]), name
    assert not torch.equal(ends["mujoco", True].position[::2], ends["mujoco", False].position[::2])


def test_a_row_that_is_not_finite_stays_so_and_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo would put it back to its start and write a file."""
    monkeypatch.chdir(tmp_path)
    model, law = build(asymmetric_robot(), CONTROLLERS.get("no_control"), 3, F64)
    state, action = start_state(model, 3), random_actions(law, model, 3)
    well = fly(mujoco_backend(), model, law, state, action)
    state.lin_vel[1, 0], state.position[2, 1] = torch.nan, 1e10
    ill = fly(mujoco_backend(), model, law, state, action)
    assert torch.equal(well.position[0], ill.position[0])
    assert ill.position[1:].isnan().all()
    assert not list(tmp_path.iterdir())


def test_a_state_in_float32_is_stepped_in_float64_and_rounded_once() -> None:
    """One step from the same numbers: half a unit in the last place beside the rounding of the wrench."""
    ends = []
    for dtype in (torch.float32, F64):
        model, law = build(ROBOTS.get("base_quadrotor"), CONTROLLERS.get("no_control"), 8, dtype)
        state = as_type(as_type(start_state(model, 8), torch.float32), dtype)
        ends.append(fly(mujoco_backend(), model, law, state, random_actions(law, model, 8).float().to(dtype), steps=1))
    assert ends[0].position.dtype == torch.float32
    assert_same(ends[1], as_type(ends[0], F64), bound=2e-6)


def test_rk4_is_refused_by_name() -> None:
    """Its stages would see a wrench that does not change."""
    model, law = build(asymmetric_robot(), CONTROLLERS.get("no_control"), 1, F64)
    with pytest.raises(CapabilityError, match="backend mujoco: no integrator 'rk4'. Known: euler"):
        mujoco_backend().allocate(model, law, integrator="rk4")


@pytest.mark.parametrize("name", ["torch", "warp", "mujoco"])
def test_a_top_with_products_of_inertia_precesses_on_every_backend(name: str) -> None:
    """Without torque a symmetric top about a turned axis n keeps w.n, and its lateral rate turns by (Jn / J - 1) w.n t."""
    turn = quat_to_matrix(quat_from_euler(torch.tensor([[0.4, -0.3, 0.2]], dtype=F64)))[0]
    top = turn @ torch.diag(torch.tensor([3e-3, 3e-3, 5e-3], dtype=F64)) @ turn.T
    rows = tuple(tuple(row) for row in (0.5 * (top + top.T)).tolist())
    dtype, dt, steps = (torch.float32 if name == "warp" else F64), 1e-4, 2000
    state = start(1)
    state.ang_vel[:] = torch.tensor([2.0, 0.0, 5.0], dtype=F64) @ turn.T
    robot = replace(asymmetric_robot(), body=BodyCfg(mass=0.5, inertia=rows, source="test"))
    model, law = build(robot, CONTROLLERS.get("rotor_speed_control"), 1, dtype)
    idle = torch.zeros(1, 4, dtype=dtype)
    end = fly(BACKENDS.get(name)(), model, law, as_type(state, dtype), idle, steps=steps, dt=dt)
    angle = torch.tensor((5.0 / 3.0 - 1.0) * 5.0 * dt * steps)
    expected = torch.stack((2.0 * angle.cos(), 2.0 * angle.sin(), torch.tensor(5.0))).double()
    torch.testing.assert_close(end.ang_vel.double()[0] @ turn, expected, rtol=0.0, atol=30.0 * dt)
