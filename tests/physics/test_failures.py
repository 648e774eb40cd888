"""Motors that fail, rotors that are stuck, supplies that break down at a moment of each environment's own, in closed form."""

from math import exp

import pytest
import torch
from torch import Tensor

from aerial_gym.physics import EFFECTS, INTEGRATORS, Model, TorchBackend, WarpBackend, accelerations, build_model
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.test_effects_with_memory import TAU_DOWN, TAU_UP
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, rest_state, single

TOLD, START = 900.0, 500.0
"""Speeds [rad/s]."""

FAILING = [(1.0, 0.5, 0.03), (3.0, 0.0, 0.1), (4.0, 0.8, 0.0), (2.0, 0.3, 1e4)]
"""Rotor, factor and moment [s] of four environments; the last one does not live to see it."""

STUCK = [(1.0, 0.03), (3.0, 0.1), (4.0, 0.0), (2.0, 1e4)]
"""Rotor and moment [s] likewise."""

BROWN = [(0.5, 0.03, 0.05), (0.0, 0.1, 1.0), (0.8, 0.0, 0.07), (0.3, 1e4, 1.0)]
"""Factor, moment and duration [s] likewise."""


def make_model(name: str, rows: list[tuple[float, ...]], dtype: torch.dtype = F64) -> Model:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=len(rows), dtype=dtype)
    return build_model(vehicle, [(EFFECTS.get(name), torch.tensor(rows, dtype=dtype))])


def lag_speed(speed: float, rest: float, span: float) -> float:
    return rest + (speed - rest) * exp(-max(span, 0.0) / (TAU_UP if rest > speed else TAU_DOWN))


def failure_speeds(time: float) -> Tensor:
    """Return those of all rotors, (E, R): the failing one tends to a part of the command from its moment on."""
    result = torch.full((4, 4), lag_speed(START, TOLD, time), dtype=F64)
    for env, (motor, scale, moment) in enumerate(FAILING):
        before = lag_speed(START, TOLD, min(time, moment))
        result[env, int(motor) - 1] = lag_speed(before, scale * TOLD, time - moment)
    return result


def jam_speeds(time: float) -> Tensor:
    """Return those of all rotors, (E, R): the stuck one has what it had at its moment."""
    result = torch.full((4, 4), lag_speed(START, TOLD, time), dtype=F64)
    for env, (motor, moment) in enumerate(STUCK):
        result[env, int(motor) - 1] = lag_speed(START, TOLD, min(time, moment))
    return result


def brown_speeds(time: float) -> Tensor:
    """Return those of all rotors, (E, R): to the command, to a part of it, to the command again."""
    rows = []
    for scale, moment, duration in BROWN:
        before = lag_speed(START, TOLD, min(time, moment))
        during = lag_speed(before, scale * TOLD, min(time - moment, duration))
        rows.append([lag_speed(during, TOLD, time - moment - duration)] * 4)
    return torch.tensor(rows, dtype=F64)


CASES = {
    "motor_failure": (FAILING, failure_speeds),
    "stuck_rotor": (STUCK, jam_speeds),
    "brown_out": (BROWN, brown_speeds),
}


@pytest.mark.parametrize("integrator", list(INTEGRATORS))
@pytest.mark.parametrize("name", CASES)
def test_speeds_are_those_of_the_lag_from_moment_to_moment(name: str, integrator: str) -> None:
    dt, (rows, expected) = 0.005, CASES[name]
    model = make_model(name, rows)
    memory, state = make_memory(model, dt), rest_state(4, rotor_speed=[START] * 4)
    told = torch.full((4, 4), TOLD, dtype=F64)
    for step in range(1, 41):
        state, memory = fly_remembering(model, memory, state, [told], dt, integrator)
        torch.testing.assert_close(state.rotor_speed, expected(step * dt), atol=1e-9, rtol=0.0)


@pytest.mark.parametrize("name", CASES)
def test_the_kernel_does_the_same(name: str) -> None:
    rows, expected = CASES[name]
    backend, state, told = WarpBackend(), single(rest_state(4, rotor_speed=[START] * 4)), torch.full((4, 4), TOLD)
    backend.allocate(make_model(name, rows, torch.float32), SpeedControl(), integrator="euler")
    for step in range(1, 9):
        backend.step(state, told, 0.005, 5)
        torch.testing.assert_close(state.rotor_speed.double(), expected(0.025 * step), atol=2e-3, rtol=0.0)


@pytest.mark.parametrize("backend", [pytest.param(TorchBackend, marks=pytest.mark.slow), WarpBackend])
def test_a_stuck_rotor_keeps_its_speed_whatever_it_is_told(backend: type) -> None:
    used, state = backend(), single(rest_state(4, rotor_speed=[START] * 4))
    used.allocate(make_model("stuck_rotor", [(2.0, 0.05)] * 4, torch.float32), SpeedControl(), integrator="euler")
    used.step(state, torch.full((4, 4), TOLD), 0.005, 10)
    kept = state.rotor_speed[:, 1].clone()
    for told in (0.0, TOLD, 300.0):
        used.step(state, torch.full((4, 4), told), 0.005, 200)
        assert torch.equal(state.rotor_speed[:, 1], kept)
        assert float((state.rotor_speed[:, 0] - told).abs().max()) < 0.5


@pytest.mark.parametrize("backend", [pytest.param(TorchBackend, marks=pytest.mark.slow), WarpBackend])
def test_a_stuck_rotor_comes_back_to_its_speed_after_a_brown_out(backend: type) -> None:
    """It slows down with the others to half of its speed, and then to the speed at which it was stuck, not the one it has."""
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1)
    rows = {"stuck_rotor": (2.0, 0.05), "brown_out": (0.5, 0.1, 2.0)}
    effects = [(EFFECTS.get(name), torch.tensor([row])) for name, row in rows.items()]
    used, state = backend(), single(rest_state(rotor_speed=[START] * 4))
    used.allocate(build_model(vehicle, effects), SpeedControl(), integrator="euler")
    result = []
    for span in (0.05, 2.0, 2.0):
        used.step(state, torch.full((1, 4), TOLD), 0.005, round(span / 0.005))
        result.append(float(state.rotor_speed[0, 1]))
    stuck, slowed, back = result
    assert slowed == pytest.approx(0.5 * stuck, rel=1e-4)
    assert back == pytest.approx(stuck, rel=1e-4)


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
@pytest.mark.parametrize("name", CASES)
def test_a_reset_mends_the_masked_rows_until_their_moment(name: str, backend: type) -> None:
    """Those count from the reset on; the others stay as they are, bit for bit as without it."""
    rows, expected = CASES[name]
    told, mask = torch.full((4, 4), TOLD), torch.tensor([True, False, True, False])
    kept, reset = backend(), backend()
    flown, begun = (single(rest_state(4, rotor_speed=[START] * 4)) for _ in range(2))
    for each in (kept, reset):
        each.allocate(make_model(name, rows, torch.float32), SpeedControl(), integrator="euler")
    for _ in range(6):
        kept.step(flown, told, 0.005, 5)
        reset.step(begun, told, 0.005, 5)
    reset.reset_memory(mask)
    begun.rotor_speed[mask] = START
    for _ in range(2):
        kept.step(flown, told, 0.005, 5)
        reset.step(begun, told, 0.005, 5)
    assert torch.equal(flown.rotor_speed[~mask], begun.rotor_speed[~mask])
    torch.testing.assert_close(begun.rotor_speed[mask].double(), expected(0.05)[mask], atol=2e-3, rtol=0.0)


@pytest.mark.parametrize(("moment", "last_whole"), [(0.0124, 2), (0.0126, 3)])
def test_it_fails_at_the_boundary_between_substeps_that_is_nearest(moment: float, last_whole: int) -> None:
    dt, model = 0.005, make_model("motor_failure", [(1.0, 0.0, moment)])
    memory, state, whole = make_memory(model, dt), rest_state(rotor_speed=[TOLD] * 4), 0
    for _ in range(6):
        state, memory = fly_remembering(model, memory, state, [torch.full((1, 4), TOLD, dtype=F64)], dt)
        whole += int(state.rotor_speed[0, 0] == TOLD)
    assert whole == last_whole


def test_a_lost_rotor_turns_the_vehicle_to_its_side() -> None:
    """Rotor 1 stands ahead on the right: without it the vehicle falls to +x roll (right) and +y pitch (nose down). At rest
    with half of the command it has a quarter of the thrust: the torque about x is ``y (4 - 1/4 - 3) T`` of it."""
    robot = ROBOTS.get("base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, [(EFFECTS.get("motor_failure"), torch.tensor([(1.0, 0.5, 0.0)], dtype=F64))])
    told = torch.full((1, 4), 1000.0, dtype=F64)
    start = rest_state(rotor_speed=[1000.0] * 4)
    end, _ = fly_remembering(model, make_memory(model, 0.01), start, [told] * 200, 0.01)
    still_again = rest_state(rotor_speed=end.rotor_speed[0].tolist())
    turn = accelerations(build_model(vehicle), still_again).ang_acc[0]
    lost = 0.75 * 3.485449e-7 * 1000.0**2
    expected = torch.tensor([0.13 * lost / 4.225e-4, 0.13 * lost / 4.225e-4], dtype=F64)
    torch.testing.assert_close(turn[:2], expected, rtol=1e-9, atol=0.0)
    assert abs(turn[2].item()) == pytest.approx(0.01 * lost / 8.45e-4, rel=1e-9)
