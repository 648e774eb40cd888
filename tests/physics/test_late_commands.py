"""A dead time before rotors of any kind: shifted commands, exact at every fraction of a substep, momentum kept."""

from dataclasses import replace
from math import exp

import pytest
import torch
from torch import Tensor

from aerial_gym.physics import EFFECTS, INTEGRATORS, WarpBackend, advance, build_model, vehicle_from_config
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.rotor_lag import CommandSwitch, follow_command, slew_limited_lag, stage_rates, vehicle_lag
from aerial_gym.physics.vehicle import Vehicle
from tests.physics.rotor_types import REVERSIBLE, three_type_robot, with_rotor
from tests.physics.swing import fly_remembering
from tests.physics.test_effects import momentum
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, make_effects, random_state, rest_state, single
from tests.repetitions import rare_values

DT, PARTS, STEPS = 0.004, 5, 60
"""Length of a substep [s], in how many the reference divides it, and how many there are."""


def commands(step: int) -> Tensor:
    """Return the rotor commands of a substep for ``three_type_robot``, (1, 4): speeds [rad/s], in force mode a thrust [N]."""
    g = torch.Generator().manual_seed(step // 3)
    share = torch.rand(1, 4, dtype=F64, generator=g)
    return torch.tensor([[-1000.0, 200.0, -3.0, -900.0]], dtype=F64) + share * torch.tensor(
        [[2400.0, 1200.0, 8.0, 2000.0]], dtype=F64
    )


def shift_commands(vehicle: Vehicle, start: Tensor, late: int, steps: int) -> list[Tensor]:
    limits = [getattr(vehicle, n) for n in ("time_constant_up", "time_constant_down", "slew_rate", "slew_rate_down")]
    state, result = start, []
    for part in range(steps * PARTS):
        given = (part - late) // PARTS
        if given >= 0:  # nothing has come through before
            state = slew_limited_lag(state, commands(given), *limits, DT / PARTS)
        if part % PARTS == PARTS - 1:
            result.append(state)
    return result


@pytest.mark.parametrize("integrator", list(INTEGRATORS))
@pytest.mark.parametrize("late", [0, 2, 5, 13, 124])
def test_signed_and_limited_rotors_follow_commands_that_much_later(late: int, integrator: str) -> None:
    """Reversible, in force mode, with slew rates: as if the same commands had been given later, to round-off."""
    robot = three_type_robot()
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    vehicle = replace(vehicle, dead_band=0.0 * vehicle.dead_band)
    model = build_model(vehicle, make_effects({"actuation_delay": {"delay": late * DT / PARTS}}, 1), gravity=0.0)
    state = rest_state(rotor_speed=[300.0, 400.0, 1.0, -300.0])
    memory, expected = make_memory(model, DT), shift_commands(vehicle, state.rotor_speed, late, STEPS)
    assert min(rows.min() for rows in expected) < -310.0
    for step in range(STEPS):
        state, memory = fly_remembering(model, memory, state, [commands(step)], DT, integrator)
        torch.testing.assert_close(state.rotor_speed, expected[step], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("integrator", rare_values(INTEGRATORS, ["rk4"]))
def test_the_kernel_delays_signed_and_limited_rotors(integrator: str) -> None:
    late = [0, 2, 5, 13]
    robot = three_type_robot()
    robot = replace(robot, rotors={name: replace(r, dead_band=0.0) for name, r in robot.rotors.items()})
    vehicle = vehicle_from_config(robot, num_envs=4)
    delays = torch.tensor([[n * DT / PARTS] for n in late])
    backend, state = WarpBackend(), single(rest_state(4, rotor_speed=[300.0, 400.0, 1.0, -300.0]))
    exact, start = vehicle_from_config(robot, num_envs=1, dtype=F64), state.rotor_speed[:1].double()
    backend.allocate(
        build_model(vehicle, [(EFFECTS.get("actuation_delay"), delays)]), SpeedControl(), integrator=integrator
    )
    expected = [shift_commands(exact, start, n, 20) for n in late]
    for step in range(20):
        backend.step(state, commands(step).float().expand(4, -1).contiguous(), DT, 1)
        for env in range(4):
            near = (state.rotor_speed[env].double() - expected[env][step][0]).abs()
            assert (near < torch.tensor([2e-3, 2e-3, 1e-5, 2e-3])).all(), (step, env)


def test_a_rotor_reverses_late_along_its_closed_form() -> None:
    """From 300 to -200 rad/s, 3.5 substeps late, without slew limit: it falls from then on, and grows backwards."""
    vehicle = vehicle_from_config(
        with_rotor(asymmetric_robot(), replace(REVERSIBLE, slew_rate=None, dead_band=0.0)), num_envs=1, dtype=F64
    )
    model = build_model(vehicle, make_effects({"actuation_delay": {"delay": 3.5 * DT}}, 1), gravity=0.0)
    state, memory = rest_state(rotor_speed=[300.0] * 4), make_memory(model, DT)
    state, memory = fly_remembering(model, memory, state, [torch.full((1, 4), -200.0, dtype=F64)] * 20, DT)
    since = 16.5 * DT
    until_zero = 0.05 * torch.tensor(500.0 / 200.0).double().log().item()
    expected = -200.0 * (1.0 - exp(-(since - until_zero) / 0.03))
    assert until_zero < since
    assert state.rotor_speed[0, 0].item() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("change", [0.0, 0.3e-3, 0.002, 0.0031])
def test_the_rates_of_a_step_sum_up_to_its_change(change: float) -> None:
    """Simpson's rule over the stages is exact wherever the command changes; without a change they are those of one command."""
    lag = vehicle_lag(vehicle_from_config(three_type_robot(), num_envs=1, dtype=F64))
    start, earlier, later = (torch.tensor([row], dtype=F64) for row in (
        [100.0, 500.0, 1.0, -50.0], [-300.0, 900.0, 3.0, 80.0], [600.0, 450.0, -2.0, -400.0]
    ))  # fmt: skip
    both = CommandSwitch(earlier=earlier, later=later, change=torch.tensor([[change]], dtype=F64))
    half, end = (follow_command(lag, start, both, t) for t in (0.5 * DT, DT))
    rates = stage_rates(lag, (start, half, end), both, DT)
    total = DT * (rates[0] + 4.0 * rates[1] + rates[2]) / 6.0
    torch.testing.assert_close(total, end - start, rtol=1e-12, atol=1e-12)
    if change == 0.0:
        plain = vehicle_lag(vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64))
        start = start.abs()
        half, end = (follow_command(plain, start, later.abs(), t) for t in (0.5 * DT, DT))
        both = CommandSwitch(earlier=earlier, later=later.abs(), change=both.change)
        alone = stage_rates(plain, (start, half, end), later.abs(), DT)
        for rate, other in zip(stage_rates(plain, (start, half, end), both, DT), alone, strict=True):
            # the error of Simpson's rule for an exponential: (dt / tau)^4 / 2880 of the rate
            torch.testing.assert_close(rate, other, rtol=2.0 * (DT / 0.03) ** 4 / 2880.0, atol=0.0)


def test_angular_momentum_is_kept_where_commands_arrive_within_substeps() -> None:
    """Rotors without thrust and drag in a tumbling body: what is lost is of second order in its turn during a substep."""
    jr, rotor = 2e-6, asymmetric_robot().rotor
    silent = replace(rotor, thrust_map=(0.0, 0.0, 1e-30), torque_map=(0.0, 0.0, 0.0), thrust_range=(0.0, 1e-24))
    vehicle = vehicle_from_config(with_rotor(asymmetric_robot(), silent), num_envs=8, dtype=F64)
    start = random_state(8)
    command = start.rotor_speed * torch.tensor([1.5, 0.4, 1.2, 0.8], dtype=F64)
    values = {"rotor_inertia": {"jr": jr}, "actuation_delay": {"delay": 2.4 * DT}}
    model = build_model(vehicle, make_effects(values, 8), gravity=0.0)
    end = advance(model, INTEGRATORS["rk4"], SpeedControl(), start, command, DT, 25)
    lost = (momentum(model, end, jr) - momentum(model, start, jr)).norm(dim=1)
    gained = jr * (end.rotor_speed - start.rotor_speed).abs().sum(1)
    assert (gained > 1e-3).all()
    assert (lost < gained * (DT * start.ang_vel.norm(dim=1)) ** 2).all()
