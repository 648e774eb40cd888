"""Delay, battery, gusts and random forces against closed forms; what a backend remembers and forgets."""

from dataclasses import replace
from itertools import pairwise
from math import exp, sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym.config.environment import EnvironmentCfg
from aerial_gym.config.robot import BatteryCfg, RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.math.random import Randomness
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, Model, TorchBackend, WarpBackend, build_model
from aerial_gym.physics.effects.actuation import speed_factor, voltage_under_load
from aerial_gym.physics.memory import begin_substep, end_substep, link_state_of_load, make_memory
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.vehicles import (
    BATTERY,
    CEILING,
    F64,
    ON_RIGID,
    SpeedControl,
    asymmetric_robot,
    make_effects,
    random_state,
    rest_state,
    single,
    strong_effects,
)

TAU_UP, TAU_DOWN = 0.03, 0.05
"""Of ``asymmetric_robot`` [s]."""

REMEMBERING = [name for name in ON_RIGID if EFFECTS.get(name).remembers]


def make_model(values: dict[str, dict[str, float]], num_envs: int = 1, robot: RobotCfg | None = None, **scene) -> Model:
    vehicle = vehicle_from_config(robot or asymmetric_robot(), num_envs=num_envs, dtype=F64)
    return build_model(vehicle, make_effects(values, num_envs), **{"ceiling_height": CEILING, **scene})


def speed_after_delay(time: float, delay: float, speed: float, commands: list[tuple[float, float]]) -> float:
    """Return the speed under commands (from when, what), each of which acts ``delay`` later; none acts before."""
    arrivals = [(start + delay, command) for start, command in commands] + [(time, 0.0)]
    for (start, command), (end, _) in pairwise(arrivals):
        if start < time:
            tau = TAU_UP if command > speed else TAU_DOWN
            speed = command + (speed - command) * exp(-(min(end, time) - start) / tau)
    return speed


@pytest.mark.parametrize("integrator", list(INTEGRATORS))
@pytest.mark.parametrize("delay", [0.0, 0.012, 0.0092, 0.0999])
def test_delayed_commands_act_exactly_that_much_later(delay: float, integrator: str) -> None:
    """Three substeps, a fraction, and near the bound: the speed at every end of a substep, rising and falling."""
    dt, model = 0.004, make_model({"actuation_delay": {"delay": delay}})
    memory, state, levels = make_memory(model, dt), rest_state(rotor_speed=[500.0] * 4), [900.0, 300.0, 700.0, 650.0]
    commands = [(0.028 * k, level) for k, level in enumerate(levels)]
    for step in range(50):
        held = torch.full((1, 4), levels[min(step // 7, 3)], dtype=F64)
        state, memory = fly_remembering(model, memory, state, [held], dt, integrator)
        expected = speed_after_delay((step + 1) * dt, delay, 500.0, commands)
        assert abs(state.rotor_speed[0, 0].item() - expected) < 1e-9, step


def test_rotors_without_lag_follow_the_delayed_command() -> None:
    model = make_model({"actuation_delay": {"delay": 0.006}})
    none = torch.zeros_like(model.vehicle.time_constant_up)
    model = replace(model, vehicle=replace(model.vehicle, time_constant_up=none, time_constant_down=none))
    levels = [torch.full((1, 4), level, dtype=F64) for level in (700.0, 800.0, 900.0, 950.0)]
    end, _ = fly_remembering(model, make_memory(model, 0.004), rest_state(rotor_speed=[500.0] * 4), levels, 0.004)
    torch.testing.assert_close(end.rotor_speed, torch.full((1, 4), 900.0, dtype=F64))


def test_the_voltage_under_load_obeys_kirchhoff() -> None:
    """V = E - r I, V I = P; beyond E² / 4 r it is E / 2 (within 1e-3); without resistance E."""
    open_voltage, resistance = torch.tensor(12.0, dtype=F64), torch.tensor(0.1, dtype=F64)
    power = torch.tensor([0.0, 50.0, 200.0, 350.0], dtype=F64)
    voltage = voltage_under_load(open_voltage, resistance, power)
    torch.testing.assert_close(voltage, open_voltage - resistance * power / voltage, atol=1e-12, rtol=0)
    assert (voltage > 6.0).all()
    assert abs(voltage_under_load(open_voltage, resistance, 2.0 * power[3:]).item() / 6.0 - 1.0) < 2e-3
    assert voltage_under_load(open_voltage, 0.0 * resistance, power[2]) == 12.0


def test_the_speed_factor_is_linear_in_the_voltage() -> None:
    result = speed_factor(
        *(torch.tensor(value, dtype=F64) for value in ([11.1, 10.0, 12.6, 1.0], [11.1] * 4, [0.5, 1.0, 1.0, 2.0]))
    )
    torch.testing.assert_close(result, torch.tensor([1.0, 10.0 / 11.1, 12.6 / 11.1, 0.0], dtype=F64))


def test_a_drained_battery_slows_the_rotors() -> None:
    """No resistance, constant speed w: E dE / dt = -P (E_0 - E_1) / Q, so that E² falls on a line."""
    battery = BatteryCfg(
        nominal_voltage=11.0, full_voltage=12.0, empty_voltage=9.0, internal_resistance=0.0, capacity=60.0,
        efficiency=0.5, source="test",
    )  # fmt: skip
    robot = replace(asymmetric_robot(), battery=battery)
    model, speed = make_model({"battery_sag": {"gain": 0.0}}, robot=robot), 800.0
    held, dt = torch.full((1, 4), speed, dtype=F64), 0.01
    memory, state = make_memory(model, dt), rest_state(rotor_speed=[speed] * 4)
    _, memory = fly_remembering(model, memory, state, [held] * 200, dt)
    power = 4 * (2e-6 * speed + 5e-8 * speed**2) * speed / 0.5
    charge = memory.numbers[0, 0].item()
    open_voltage = sqrt(12.0**2 - 2.0 * power * 3.0 / 60.0 * 2.0)
    assert abs(12.0 - 3.0 * charge / 60.0 - open_voltage) < dt * power / 9.0 * 3.0 / 60.0  # one Euler step
    _, empty = fly_remembering(model, memory, state, [held] * 200, dt)
    assert empty.numbers[0, 1].item() == pytest.approx(9.0)
    sagging = make_model({"battery_sag": {"gain": 0.7}}, robot=robot)
    _, followed, memory = begin_substep(sagging, memory, state.rotor_speed, held, dt)
    expected = speed * (1.0 - 0.7 * (1.0 - memory.numbers[0, 1].item() / 11.0))
    torch.testing.assert_close(followed, torch.full((1, 4), expected, dtype=F64), atol=1e-9, rtol=0)
    assert abs(memory.numbers[0, 1].item() - open_voltage) < 0.01


def test_the_battery_current_is_that_of_power_and_voltage() -> None:
    """dq/dt = P / (efficiency V) with V under load, at the first substep."""
    model = make_model({"battery_sag": {"gain": 0.2}})
    memory, speed = make_memory(model, 0.01), torch.full((1, 4), 900.0, dtype=F64)
    _, _, memory = begin_substep(model, memory, speed, speed, 0.01)
    power = 4 * (2e-6 * 900.0 + 5e-8 * 900.0**2) * 900.0 / BATTERY.efficiency
    voltage = 0.5 * (12.6 + sqrt(12.6**2 - 4.0 * 0.05 * power))
    torch.testing.assert_close(memory.numbers[0], torch.tensor([0.01 * power / voltage, voltage], dtype=F64))


def test_battery_files_are_checked() -> None:
    with pytest.raises(ConfigError, match=r"effect battery_sag: the robot file must give battery"):
        EFFECTS.get("battery_sag").check(ROBOTS.get("tinyprop"))
    EFFECTS.get("battery_sag").check(asymmetric_robot())
    for name, value in (("empty_voltage", 13.0), ("internal_resistance", -0.1), ("efficiency", 1.1), ("capacity", 0.0)):
        with pytest.raises(ConfigError, match=f"BatteryCfg.{name}"):
            replace(BATTERY, **{name: value})


@pytest.mark.parametrize(("dt", "vertical"), [(0.02, {}), (0.2, {}), (0.2, {"vertical": 0.4, "vertical_time": 0.5})])
def test_gusts_have_their_variance_and_correlation_at_every_step(dt: float, vertical: dict[str, float]) -> None:
    """Variance std² at once and later, exp(-t / T) after 0.4 s, axes independent; bounds: five standard deviations."""
    num, corr_time = 20000, torch.tensor([0.5, 0.5, 0.5 * vertical.get("vertical_time", 1.0)], dtype=F64)
    std = torch.tensor([3.0, 3.0, 3.0 * vertical.get("vertical", 1.0)], dtype=F64)
    model = make_model({"gusts": {"std": 3.0, "corr_time": 0.5} | vertical}, num)
    memory, rotors = make_memory(model, dt), torch.zeros(num, 4, dtype=F64)
    winds: list[Tensor] = []
    for _ in range(round(1.0 / dt) + 1):
        _, _, memory = begin_substep(model, memory, rotors, rotors, dt)
        winds.append(memory.numbers)
        memory = end_substep(memory, link_state_of_load(model, memory))
    back = round(0.4 / dt)
    for wind in (winds[0], winds[-1]):
        assert (wind.mean(0).abs() < 5.0 * std / sqrt(num)).all()
        assert ((wind.var(0) / std**2 - 1.0).abs() < 5.0 * sqrt(2.0 / num)).all()
    correlation = (winds[-1][:, None] * winds[-1 - back][..., None]).mean(0) / torch.outer(
        std, std
    )  # rows: earlier axis
    assert ((correlation - torch.diag((-0.4 / corr_time).exp())).abs() < 5.0 / sqrt(num)).all()


@pytest.mark.parametrize(("dt", "hold"), [(0.002, 0.002), (0.001, 0.002), (0.0005, 0.003), (0.01, 0.002)])
def test_a_random_force_is_uniform_and_held_for_its_interval(dt: float, hold: float) -> None:
    """Variance f² / 3 on each axis, independent of the interval before; bounds: five standard deviations of 20,000 draws."""
    num, largest = 20000, torch.tensor([0.1, 0.2, 0.3], dtype=F64)
    model = make_model({"random_force": {"x": 0.1, "y": 0.2, "z": 0.3, "hold": hold}}, num)
    memory, rotors = make_memory(model, dt), torch.zeros(num, 4, dtype=F64)
    forces: list[Tensor] = []
    substeps = max(round(hold / dt), 1)
    for _ in range(3 * substeps):
        _, _, memory = begin_substep(model, memory, rotors, rotors, dt)
        forces.append(memory.numbers / largest)
        memory = end_substep(memory, link_state_of_load(model, memory))
    for i, force in enumerate(forces):
        assert torch.equal(force, forces[i - i % substeps])
    for i in range(0, 3 * substeps, substeps):
        assert (forces[i].abs() <= 1.0).all()
        assert (forces[i].mean(0).abs() < 5.0 * sqrt(1.0 / 3.0 / num)).all()
        assert ((3.0 * forces[i].var(0) - 1.0).abs() < 5.0 * sqrt(0.8 / num)).all()  # E x^4 = 1/5: var of 3 x² is 0.8
    products = (forces[substeps][:, None] * forces[0][..., None]).mean(0)
    assert (products.abs() < 5.0 / 3.0 / sqrt(num)).all()


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_random_force_pushes_along_the_world_alike_on_both_backends(backend) -> None:
    """Along world z alone at any attitude; the velocity after n intervals has the deviation f sqrt(n / 3) T / m."""
    num, steps, hold, largest = 4000, 50, 0.002, 0.1
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=num)
    rows = [(EFFECTS.get("random_force"), torch.tensor([0.0, 0.0, largest, hold]).expand(num, -1))]
    stepper = backend()
    stepper.allocate(
        build_model(vehicle, rows, gravity=0.0), SpeedControl(), integrator="euler", random=Randomness(num)
    )
    state = single(rest_state(num, attitude=quat_from_euler(torch.tensor([[0.4, -0.7, 1.0]], dtype=F64))[0].tolist()))
    stepper.step(state, torch.zeros(num, 4), hold, steps)
    assert state.lin_vel[:, :2].abs().max() < 1e-6
    assert state.ang_vel.abs().max() < 1e-6
    deviation = largest * sqrt(steps / 3.0) * hold / asymmetric_robot().body.mass
    assert abs(state.lin_vel[:, 2].std().item() / deviation - 1.0) < 5.0 / sqrt(2.0 * num)


PUSH = {
    f"{kind}_{axis}": size for kind in ("force", "torque") for axis, size in zip("xyz", (0.1, 0.2, 0.3), strict=True)
}


def test_random_pushes_are_uniform_and_come_with_their_probability() -> None:
    """In a share p of the vehicles force and torque have the variance f² / 3, else both are 0; bounds: five deviations."""
    num, probability, largest = 20000, 0.3, torch.tensor([0.1, 0.2, 0.3] * 2, dtype=F64)
    model = make_model({"random_push": PUSH | {"probability": probability, "hold": 0.002}}, num)
    memory, rotors = make_memory(model, 0.001), torch.zeros(num, 4, dtype=F64)
    pushes: list[Tensor] = []
    for _ in range(4):
        _, _, memory = begin_substep(model, memory, rotors, rotors, 0.001)
        pushes.append(memory.numbers / largest)
        memory = end_substep(memory, link_state_of_load(model, memory))
    assert torch.equal(pushes[0], pushes[1])
    assert torch.equal(pushes[2], pushes[3])
    acts = [(push != 0.0).all(-1) for push in (pushes[0], pushes[2])]
    for push, act in zip((pushes[0], pushes[2]), acts, strict=True):
        assert torch.equal((push != 0.0).any(-1), act)
        assert abs(act.double().mean() - probability) < 5.0 * sqrt(probability * (1.0 - probability) / num)
        drawn = push[act]
        assert (drawn.abs() <= 1.0).all()
        assert (drawn.mean(0).abs() < 5.0 * sqrt(1.0 / 3.0 / len(drawn))).all()
        assert ((3.0 * drawn.var(0) - 1.0).abs() < 5.0 * sqrt(0.8 / len(drawn))).all()
        covariance = drawn.T @ drawn / len(drawn)
        assert (covariance - torch.diag(covariance.diag())).abs().max() < 5.0 / 3.0 / sqrt(len(drawn))
    both = (acts[0] & acts[1]).double().mean()
    assert abs(both - probability**2) < 5.0 * sqrt(probability**2 / num)


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_random_push_acts_along_and_about_body_axes(backend) -> None:
    """At any attitude: a force along body z and a torque about body x of one interval give F T / m and M T / I."""
    num, hold, robot = 4000, 0.002, asymmetric_robot()
    robot = replace(robot, body=replace(robot.body, com=(0.0, 0.0, 0.0)))
    row = torch.tensor([0.0, 0.0, 0.1, 1e-4, 0.0, 0.0, 1.0, hold])
    stepper = backend()
    model = build_model(
        vehicle_from_config(robot, num_envs=num), [(EFFECTS.get("random_push"), row.expand(num, -1))], gravity=0.0
    )
    stepper.allocate(model, SpeedControl(), integrator="euler", random=Randomness(num))
    attitude = quat_from_euler(torch.tensor([[0.4, -0.7, 1.0]], dtype=F64))
    state = single(rest_state(num, attitude=attitude[0].tolist()))
    stepper.step(state, torch.zeros(num, 4), hold, 1)
    up = quat_rotate(attitude, torch.tensor([[0.0, 0.0, 1.0]], dtype=F64)).float()
    along = (state.lin_vel * up).sum(-1)
    assert (state.lin_vel - along.unsqueeze(-1) * up).abs().max() < 1e-8
    assert abs(along.abs().max() * robot.body.mass / (0.1 * hold) - 1.0) < 0.01
    inertia = torch.tensor(robot.body.inertia, dtype=F64)
    torque = state.ang_vel.double() @ inertia / (1e-4 * hold)
    assert torque[:, 1:].abs().max() < 1e-3
    assert abs(torque[:, 0].abs().max() - 1.0) < 0.01
    assert abs(torch.corrcoef(torch.stack((along.double(), torque[:, 0])))[0, 1]) < 5.0 / sqrt(num)


def test_a_ceiling_is_needed_by_name() -> None:
    with pytest.raises(ConfigError, match="effect ceiling_effect: there is no ceiling. Give ceiling_height"):
        make_model({"ceiling_effect": {"k": 1.0}}, ceiling_height=None)
    with pytest.raises(ConfigError, match=r"effect ceiling_effect: the robot file must give rotor.radius"):
        EFFECTS.get("ceiling_effect").check(
            replace(ROBOTS.get("tinyprop"), rotor=replace(ROBOTS.get("tinyprop").rotor, radius=None))
        )
    corner = {
        "bounds_lower_low": (0, 0, 0), "bounds_lower_high": (0, 0, 0), "bounds_upper_low": (1, 1, 1),
        "bounds_upper_high": (1, 1, 1),
    }  # fmt: skip
    with pytest.raises(ConfigError, match=r"ceiling_height = 1.0: must be above ground_height = 2.0"):
        EnvironmentCfg(
            summary="", physics_steps_per_env_step=1, ground_height=2.0, ceiling_height=1.0, source="test", **corner
        )


def run_all_effects(
    backend, num_envs: int = 4, dtype: torch.dtype = torch.float32, random: Randomness | None = None
) -> BodyState:
    robot = asymmetric_robot()
    rows = strong_effects((*REMEMBERING, "rotor_drag"), robot, num_envs, dtype=dtype, share=0.7)
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=dtype)
    backend.allocate(build_model(vehicle, rows), SpeedControl(), integrator="euler", random=random)
    return BodyState(**{name: tensor.to(dtype) for name, tensor in vars(random_state(num_envs)).items()})


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_reset_forgets_the_masked_rows_and_leaves_the_others_bit_for_bit(backend) -> None:
    actions = torch.full((4, 4), 850.0)
    kept, reset = backend(), backend()
    chance = Randomness(4)
    flown, begun = run_all_effects(kept), run_all_effects(reset, random=chance)
    start = [tensor.clone() for tensor in begun.tensors()]
    for _ in range(10):
        kept.step(flown, actions, 0.004, 5)
        reset.step(begun, actions, 0.004, 5)
    mask = torch.tensor([True, False, True, False])
    chance.begin(mask)
    reset.reset_memory(mask)
    for tensor, first in zip(begun.tensors(), start, strict=True):
        tensor[mask] = first[mask]
    fresh = backend()
    new = run_all_effects(fresh)
    for _ in range(2):
        kept.step(flown, actions, 0.004, 5)
        reset.step(begun, actions, 0.004, 5)
        fresh.step(new, actions, 0.004, 5)
    for a, b in zip(flown.tensors(), begun.tensors(), strict=True):
        assert torch.equal(a[~mask], b[~mask])
        assert not torch.equal(a[mask], b[mask])
    torch.testing.assert_close(
        begun.rotor_speed[mask], new.rotor_speed[mask], atol=1e-3, rtol=1e-5
    )  # delay and battery
    assert not torch.equal(begun.lin_vel[mask], new.lin_vel[mask])  # gusts


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_steps_go_on_with_what_is_remembered(backend) -> None:
    """Ten steps of one substep are one of ten: memory is kept between calls, and the random numbers count substeps."""
    ends, actions = [], torch.full((4, 4), 850.0)
    for calls, substeps in ((10, 1), (1, 10)):
        stepper = backend()
        state = run_all_effects(stepper)
        for _ in range(calls):
            stepper.step(state, actions, 0.004, substeps)
        ends.append(state)
    for a, b in zip(ends[0].tensors(), ends[1].tensors(), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-5)


def test_memory_survives_new_parameters() -> None:
    """A shared mass that changes composes the kernel anew: the payload swings on, commands are still on their way."""
    actions, ends = torch.full((4, 4), 850.0), []
    for stepper in (TorchBackend(), WarpBackend()):
        state = run_all_effects(stepper)
        stepper.step(state, actions, 0.004, 5)
        model = stepper._model
        mass = (1.5 * model.vehicle.mass[:1]).as_strided((4,), (0,))
        stepper.set_model(replace(model, vehicle=replace(model.vehicle, mass=mass)))
        stepper.step(state, actions, 0.004, 5)
        ends.append(torch.cat(state.tensors(), dim=-1))
    torch.testing.assert_close(ends[1], ends[0], rtol=2e-5, atol=2e-5)


def test_gradients_flow_through_memory_from_call_to_call() -> None:
    grads = []
    for calls in ((2, 4), (6,)):
        backend = TorchBackend()
        state, command = run_all_effects(backend, dtype=F64), torch.full((4, 4), 850.0, dtype=F64, requires_grad=True)
        for substeps in calls:
            state = backend.advance(state, command, 0.004, substeps)
        grads.append(torch.autograd.grad(state.lin_vel.sum(), command)[0])
    assert (grads[0] != 0.0).all()
    torch.testing.assert_close(grads[0], grads[1], atol=1e-14, rtol=1e-9)


def test_gradients_end_at_a_reset() -> None:
    backend, grads = TorchBackend(), []
    start = run_all_effects(backend, dtype=F64)
    for _ in range(2):
        command = torch.full((4, 4), 850.0, dtype=F64, requires_grad=True)
        end = backend.advance(start, command, 0.004, 6)
        end.rotor_speed.sum().backward()
        grads.append(command.grad)
        backend.reset_memory(torch.ones(4, dtype=torch.bool))
    torch.testing.assert_close(grads[0], grads[1], atol=0.0, rtol=1e-12)


def test_a_vehicle_has_one_load_and_one_delay() -> None:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    for name, label in (("slung_payload", "load"), ("actuation_delay", "delay")):
        effect = EFFECTS.get(name)
        twice = [(effect, torch.tensor([effect.neutral(asymmetric_robot())], dtype=F64))] * 2
        with pytest.raises(ConfigError, match=f"effects {name} and {name}: a vehicle has one {label} at most"):
            build_model(vehicle, twice)


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_an_effect_that_is_given_twice_acts_twice(backend) -> None:
    """Two drags of 0.1 N s/m are one of 0.2; two gusts, which draw the same, of 1 and 2 m/s are one of 3 m/s."""
    ends = []
    for drags, gusts in (((0.1, 0.1), (1.0, 2.0)), ((0.2,), (3.0,))):
        rows = [(EFFECTS.get("rotor_drag"), torch.full((2, 3), drag)) for drag in drags]
        rows += [(EFFECTS.get("gusts"), torch.tensor([[std, 0.5, 1.0, 1.0]] * 2)) for std in gusts]
        stepper, state = backend(), single(random_state(2))
        model = build_model(vehicle_from_config(asymmetric_robot(), num_envs=2), rows)
        stepper.allocate(model, SpeedControl(), integrator="rk4")
        for _ in range(4):
            stepper.step(state, torch.full((2, 4), 800.0), 0.01, 3)
        ends.append(state.lin_vel)
    torch.testing.assert_close(ends[0], ends[1], atol=1e-5, rtol=1e-5)
