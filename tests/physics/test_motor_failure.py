"""A motor that fails at a moment: the speeds of rotors and the torque that follows, against closed forms; resets."""

from math import exp

import pytest
import torch

from aerial_gym.physics import EFFECTS, INTEGRATORS, Model, TorchBackend, WarpBackend, accelerations, build_model
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.test_effects import still
from tests.physics.test_effects_with_memory import TAU_DOWN, TAU_UP, Straight, single
from tests.physics.vehicles import F64, lopsided_robot

ROWS = [(1.0, 0.5, 0.03), (3.0, 0.0, 0.1), (4.0, 0.8, 0.0), (2.0, 0.3, 1e4)]
"""Rotor, factor and moment [s] of four environments; the last one does not live to see it."""

TOLD, START = 900.0, 500.0
"""Speeds [rad/s]."""


def model_of(rows: list[tuple[float, ...]], dtype: torch.dtype = F64) -> Model:
    vehicle = vehicle_from_config(lopsided_robot(), num_envs=len(rows), dtype=dtype)
    return build_model(vehicle, [(EFFECTS.get("motor_failure"), torch.tensor(rows, dtype=dtype))])


def expected_speed(time: float, scale: float, failure: float) -> float:
    """Return the speed of a rotor that is told ``TOLD``, from the moment on ``scale`` of it; it lags up and down."""
    until = min(time, failure)
    speed = TOLD + (START - TOLD) * exp(-until / TAU_UP)
    rest = scale * TOLD
    tau = TAU_UP if rest > speed else TAU_DOWN
    return speed if time <= failure else rest + (speed - rest) * exp(-(time - failure) / tau)


def expected_speeds(time: float) -> torch.Tensor:
    """Return those of all rotors, (E, R)."""
    healthy = expected_speed(time, 1.0, 0.0)
    found = torch.full((len(ROWS), 4), healthy, dtype=F64)
    for env, (motor, scale, failure) in enumerate(ROWS):
        found[env, int(motor) - 1] = expected_speed(time, scale, failure)
    return found


@pytest.mark.parametrize("integrator", list(INTEGRATORS))
def test_one_rotor_runs_down_from_its_moment_on(integrator: str) -> None:
    dt, model = 0.005, model_of(ROWS)
    memory, state = make_memory(model, dt), still(len(ROWS), rotor_speed=[START] * 4)
    told = torch.full((len(ROWS), 4), TOLD, dtype=F64)
    for step in range(1, 41):
        state, memory = fly_remembering(model, memory, state, [told], dt, integrator)
        torch.testing.assert_close(state.rotor_speed, expected_speeds(step * dt), atol=1e-9, rtol=0.0)


@pytest.mark.parametrize(("moment", "last_whole"), [(0.0124, 2), (0.0126, 3)])
def test_it_fails_at_the_boundary_between_substeps_that_is_nearest(moment: float, last_whole: int) -> None:
    dt, model = 0.005, model_of([(1.0, 0.0, moment)])
    memory, state, whole = make_memory(model, dt), still(rotor_speed=[TOLD] * 4), 0
    for _ in range(6):
        state, memory = fly_remembering(model, memory, state, [torch.full((1, 4), TOLD, dtype=F64)], dt)
        whole += int(state.rotor_speed[0, 0] == TOLD)
    assert whole == last_whole


def test_the_kernel_fails_each_environment_in_its_own_way() -> None:
    backend, state, told = WarpBackend(), single(still(4, rotor_speed=[START] * 4)), torch.full((4, 4), TOLD)
    backend.allocate(model_of(ROWS, torch.float32), Straight(), integrator="euler")
    for step in range(1, 9):
        backend.step(state, told, 0.005, 5)
        torch.testing.assert_close(state.rotor_speed.double(), expected_speeds(0.025 * step), atol=2e-3, rtol=0.0)


def test_a_lost_rotor_turns_the_vehicle_to_its_side() -> None:
    """Rotor 1 stands ahead on the right: without it the vehicle falls to +x roll (right) and +y pitch (nose down).

    At rest with half of the command it has a quarter of the thrust: the torque about x is ``y (4 - 1/4 - 3) T`` of it.
    """
    robot = ROBOTS.get("base_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, [(EFFECTS.get("motor_failure"), torch.tensor([(1.0, 0.5, 0.0)], dtype=F64))])
    told = torch.full((1, 4), 1000.0, dtype=F64)
    start = still(rotor_speed=[1000.0] * 4)
    end, _ = fly_remembering(model, make_memory(model, 0.01), start, [told] * 200, 0.01)
    still_again = still(rotor_speed=end.rotor_speed[0].tolist())
    turn = accelerations(build_model(vehicle), still_again).ang_acc[0]
    lost = 0.75 * 3.485449e-7 * 1000.0**2
    expected = torch.tensor([0.13 * lost / 8.45e-4, 0.13 * lost / 8.45e-4], dtype=F64)
    torch.testing.assert_close(turn[:2], expected, rtol=1e-9, atol=0.0)
    assert abs(turn[2].item()) == pytest.approx(0.01 * lost / 1.69e-3, rel=1e-9)


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_reset_mends_the_masked_rows_until_their_moment(backend) -> None:
    """Those count from the reset on; the others stay broken, bit for bit as without it."""
    told, mask = torch.full((4, 4), TOLD), torch.tensor([True, False, True, False])
    kept, reset = backend(), backend()
    flown, begun = (single(still(4, rotor_speed=[START] * 4)) for _ in range(2))
    for each in (kept, reset):
        each.allocate(model_of(ROWS, torch.float32), Straight(), integrator="euler")
    for _ in range(6):
        kept.step(flown, told, 0.005, 5)
        reset.step(begun, told, 0.005, 5)
    reset.reset(mask)
    begun.rotor_speed[mask] = START
    for _ in range(2):
        kept.step(flown, told, 0.005, 5)
        reset.step(begun, told, 0.005, 5)
    assert torch.equal(flown.rotor_speed[~mask], begun.rotor_speed[~mask])
    expected = expected_speeds(0.05)
    torch.testing.assert_close(begun.rotor_speed[mask].double(), expected[mask], atol=2e-3, rtol=0.0)
