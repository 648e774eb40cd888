"""Controllers with memory: integral, filter, rates, delays and resets, each against what it must do exactly."""

from dataclasses import replace
from math import exp, pi

import pytest
import torch
from torch import Tensor

from aerial_gym.config.autopilots import (
    BetaflightCfg,
    BrescianiniCfg,
    CrazyflieLeeCfg,
    CrazyfliePidCfg,
    MellingerCfg,
    Px4Cfg,
)
from aerial_gym.config.controller import ControllerCfg, RateLoopCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.cascade import CascadeController
from aerial_gym.control.timing import make_timing
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import (
    EFFECTS,
    BodyState,
    TorchBackend,
    WarpBackend,
    build_model,
    rotor_state_for_thrust,
    state_at_rest,
    vehicle_from_config,
)
from aerial_gym.physics.effects import Condition, EffectParams, Parameter, WrenchEffect
from aerial_gym.physics.law_memory import LawMemory, fresh_law_memory
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import random_state
from tests.refusals import assert_refused
from tests.repetitions import rare_values

F64 = torch.float64
DT = 0.002
ROBOT = ROBOTS.get("base_quadrotor")
PID = CONTROLLERS.get("pid_rates_control")
BUSY = replace(
    CONTROLLERS.get("pid_velocity_control"), rate_hz=50.0,
    rate_loop=RateLoopCfg(rate_hz=250.0, derivative=(0.1, 0.2, 0.0), cutoff_hz=40.0), delay=0.014, action_delay=0.006,
)  # fmt: skip
"""Everything at once: loop every 2 steps, law every 10, its wish 7 steps late, actions 3."""


FILTERED = Px4Cfg(
    rate_hz=250.0, IMU_GYRO_CUTOFF=40.0, MC_ROLLRATE_D=0.002, MC_PITCHRATE_D=0.002, MC_YAW_TQ_CUTOFF=20.0, THR_MDL_FAC=0.4,
    MPC_XY_VEL_D_ACC=0.1, MC_ROLLRATE_FF=0.001, IMU_GYRO_NF0_FRQ=90.0, IMU_GYRO_NF1_FRQ=60.0, IMU_GYRO_NF1_BW=10.0,
)  # fmt: skip
"""Filters, feed-forward and a thrust curve of PX4."""


def make_law(cfg: ControllerCfg, num_envs: int = 1, *, dt: float = DT, dtype: torch.dtype = F64) -> CascadeController:
    return make_controller(cfg, vehicle_from_config(ROBOT, num_envs=num_envs, dtype=dtype), 9.81, dt=dt)


def turn_state(rate: list[float]) -> BodyState:
    """Return one body that turns at body rates [rad/s], level."""
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    return replace(state, ang_vel=torch.tensor([rate], dtype=F64))


def commands(law: CascadeController, actions: list[Tensor], states: list[BodyState]) -> tuple[Tensor, list[LawMemory]]:
    memory, result, memories = fresh_law_memory(law.needs, 1, states[0].position), [], []
    for action, state in zip(actions, states, strict=True):
        command, memory = law.command(state, action, memory)
        result.append(command)
        memories.append(memory)
    return torch.cat(result), memories


class Push(WrenchEffect):
    name = "push"
    summary = "a constant torque"
    parameters = tuple(
        Parameter(name=axis, unit="N m", low=-1.0, high=1.0, scale=0.01, meaning="torque") for axis in "xyz"
    )
    excitation = "none"

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        del condition
        return torch.cat((torch.zeros_like(params), params), dim=-1)


@pytest.mark.parametrize("integral", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_constant_torque_leaves_no_error_with_an_integral_and_a_known_one_otherwise(integral: bool) -> None:
    """At rest ``J (P e + I) + m = 0``: with an integral e = 0 and ``I = -m / J``, without one ``w = m / (J P)``."""
    cfg = PID if integral else replace(PID, rate_loop=RateLoopCfg(integral=(0.0, 0.0, 0.0)))
    torque = torch.tensor([[2e-4, -1e-4, 3e-5]], dtype=F64)
    law, backend, dt = make_law(cfg, dt=0.02), TorchBackend(), 0.02
    push: EffectParams = (Push(), torque)
    model = build_model(vehicle_from_config(ROBOT, num_envs=1, dtype=F64), [push])
    backend.allocate(model, law, integrator="euler")
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    state.rotor_speed.fill_(rotor_state_for_thrust(ROBOT.rotor, 0.25 * 9.81 / 4))
    backend.step(state, torch.zeros(1, 4, dtype=F64), dt, 1500 if integral else 500)
    inertia = torch.tensor([4.225e-4, 4.225e-4, 8.45e-4], dtype=F64)
    if integral:
        torch.testing.assert_close(state.ang_vel, torch.zeros(1, 3, dtype=F64), atol=1e-8, rtol=0)
        torch.testing.assert_close(backend.law_memory.numbers[:, :3], -torque / inertia, rtol=1e-6, atol=0)
    else:
        first_order = torque / (inertia * law.rate_gains.proportional)
        torch.testing.assert_close(state.ang_vel, first_order, rtol=1e-6, atol=0)


def test_the_low_pass_answers_a_ramp_with_its_exponential() -> None:
    """A body that turns up at 3 rad/s² is seen, k runs later, as ``3 (1 - exp(-2 pi f k dt))``; unknown in the first."""
    loop = RateLoopCfg(rate_hz=250.0, derivative=(0.1, 0.1, 0.1), cutoff_hz=20.0)
    law = make_law(replace(PID, rate_loop=loop))
    span, steps = 1 / 250.0, 60
    states = [turn_state([3.0 * DT * k, 0.0, 0.0]) for k in range(steps)]
    _, memories = commands(law, [torch.zeros(1, 4, dtype=F64)] * steps, states)
    for k, memory in enumerate(memories):
        expected = 3.0 * (1.0 - exp(-2.0 * pi * 20.0 * span * (k // 2)))
        assert float(memory.numbers[0, 3]) == pytest.approx(expected, abs=1e-9)


def test_the_derivative_is_taken_back_from_the_wanted_acceleration() -> None:
    """Without low-pass a body that turns up at 3 rad/s² costs ``J D 3`` of torque: the lever arms give the thrusts."""
    still, actions = RateLoopCfg(integral=(0.0, 0.0, 0.0)), [torch.zeros(1, 4, dtype=F64)] * 3
    states = [turn_state([3.0 * DT * k, 0.0, 0.0]) for k in range(3)]
    loops = still, replace(still, derivative=(0.2, 0.0, 0.0))
    without, with_it = (commands(make_law(replace(PID, rate_loop=one)), actions, states)[0] for one in loops)
    thrust = ROBOT.rotor.thrust_map[2] * (with_it**2 - without**2)
    expected = -0.2 * 3.0 * 4.225e-4 / (4 * 0.13) * torch.tensor([-1.0, -1.0, 1.0, 1.0], dtype=F64)
    torch.testing.assert_close(thrust[0], torch.zeros(4, dtype=F64), atol=1e-12, rtol=0)
    torch.testing.assert_close(thrust[1:], expected.expand(2, 4), atol=1e-9, rtol=0)


def random_flight(steps: int) -> tuple[list[Tensor], list[BodyState]]:
    g = torch.Generator().manual_seed(0)
    actions = [0.2 * torch.randn(1, 4, dtype=F64, generator=g) for _ in range(steps)]
    return actions, [turn_state((0.2 * torch.randn(3, generator=g)).tolist()) for _ in range(steps)]


def test_a_command_changes_only_when_its_loop_runs() -> None:
    law = make_law(replace(PID, rate_loop=RateLoopCfg(rate_hz=100.0)))
    result, _ = commands(law, *random_flight(30))
    changes = (result[1:] != result[:-1]).any(-1)
    assert [k + 1 for k in changes.nonzero().flatten().tolist()] == [5, 10, 15, 20, 25]


def test_a_loop_at_a_rate_of_its_own_is_the_loop_at_that_time_step() -> None:
    cfg = replace(PID, rate_loop=RateLoopCfg(rate_hz=100.0, derivative=(0.1, 0.1, 0.1), cutoff_hz=9.0))
    actions, states = random_flight(40)
    slow, _ = commands(make_law(cfg), actions, states)
    coarse, _ = commands(make_law(cfg, dt=0.01), actions[::5], states[::5])
    assert torch.equal(slow[::5], coarse)


def test_an_action_acts_exactly_its_delay_later_and_the_first_at_once() -> None:
    actions, states = random_flight(20)
    late, _ = commands(make_law(replace(PID, action_delay=0.008)), actions, states)
    shifted = [actions[max(k - 4, 0)] for k in range(20)]
    assert torch.equal(late, commands(make_law(PID), shifted, states)[0])


def test_a_wish_reaches_the_rate_loop_exactly_its_delay_later_and_is_held() -> None:
    actions, states = random_flight(40)
    late, _ = commands(make_law(replace(PID, rate_hz=1 / 0.006, delay=0.008)), actions, states)
    shifted = [actions[max(k - 4, 0) // 3 * 3] for k in range(40)]
    like = make_law(PID, dt=DT)
    slower = make_law(replace(PID, rate_hz=1 / 0.006, delay=0.008))
    like.rate_gains = slower.rate_gains
    torch.testing.assert_close(late, commands(like, shifted, states)[0], rtol=0, atol=1e-9)


def test_the_integral_stands_still_while_its_rotors_are_at_their_limits() -> None:
    law = make_law(PID)
    numbers = [[0.0, 0.05, 0.0, 50.0]] * 4 + [[0.0, 0.0, 0.0, -0.01]]
    actions = [torch.tensor([row], dtype=F64) for row in numbers]
    _, memories = commands(law, actions, [turn_state([0.0, 0.0, 0.0])] * 5)
    integrals = torch.cat([memory.numbers[:, :3] for memory in memories])
    assert (integrals[:4, 2] == 0.0).all()
    assert (integrals[1:4, 0] > integrals[:3, 0]).all()
    assert integrals[4, 2] < 0.0


def test_the_integral_has_a_limit() -> None:
    loop = RateLoopCfg(integral=(5.0, 5.0, 5.0), integral_limit=(0.03, 0.02, 0.01))
    law = make_law(replace(PID, rate_loop=loop))
    action = torch.tensor([[0.0, 0.5, -0.5, 0.2]], dtype=F64)
    _, memories = commands(law, [action] * 50, [turn_state([0.0, 0.0, 0.0])] * 50)
    expected = torch.tensor([[0.03, -0.02, 0.01]], dtype=F64)
    torch.testing.assert_close(memories[-1].numbers[:, :3], expected, atol=1e-12, rtol=0)


def fly(
    backend, cfg: ControllerCfg, dtype: torch.dtype, *, effects: tuple[str, ...] = (), rows: slice = slice(None)
) -> list[BodyState]:
    """Return the states after a masked reset halfway and at the end of a flight of 0.24 s; ``rows`` of 6 environments."""
    vehicle = vehicle_from_config(ROBOT, num_envs=len(range(6)[rows]), dtype=dtype)
    pairs = []
    for name in effects:
        effect = EFFECTS.get(name)
        row = [a + p.scale for a, p in zip(effect.neutral(ROBOT), effect.parameters, strict=True)]
        pairs.append((effect, torch.tensor(row, dtype=dtype).expand(vehicle.num_envs, -1).clone()))
    backend.allocate(build_model(vehicle, pairs), make_controller(cfg, vehicle, 9.81, dt=DT), integrator="euler")
    start = random_state(6, seed=5)
    speed = torch.full_like(start.rotor_speed, rotor_state_for_thrust(ROBOT.rotor, 0.25 * 9.81 / 4))
    start = replace(start, ang_vel=0.3 * start.ang_vel, rotor_speed=speed)
    state = BodyState(**{k: v[rows].to(dtype).contiguous() for k, v in vars(start).items()})
    g = torch.Generator().manual_seed(2)
    actions = [0.3 * torch.randn(6, 4, dtype=F64, generator=g)[rows].to(dtype).contiguous() for _ in range(12)]
    ends = []
    for k, action in enumerate(actions):
        backend.step(state, action, DT, 10)
        if k == 5:
            backend.reset_memory(torch.tensor([True, False, False, True, True, False])[rows])
            ends.append(BodyState(**{name: tensor.clone() for name, tensor in vars(state).items()}))
    return [*ends, state]


TUNED = BetaflightCfg(
    rate_hz=250.0, rates_type="ACTUAL", roll_expo=0.5, p_roll=45.0, i_roll=80.0, d_roll=40.0, f_roll=120.0, d_pitch=30.0,
    gyro_lpf1_type="BIQUAD", gyro_lpf1_static_hz=60.0, gyro_lpf2_static_hz=90.0, dterm_lpf1_type="BIQUAD", iterm_relax="RPY",
    tpa_mode="PD", tpa_breakpoint=1200.0, version="4.5",
)  # fmt: skip
"""Every part of Betaflight's rate loop."""

EVERY_MELLINGER = MellingerCfg(
    massThrust=15000.0, ki_m_xy=40.0, ki_m_z=500.0, i_range_m_xy=0.02, kd_omega_rp=3.0, i_range_z=0.01
)
EVERY_PID = CrazyfliePidCfg(
    rate_hz=250.0, position_ki=(0.1, 0.2, 0.5), attitude_ki=(3.0, 3.0, 1.0), attitude_kd=(0.01, 0.0, 0.35),
    attitude_limit=(0.02, 0.02, 360.0), rate_kd=(0.1, 0.1, 0.0), rate_limit=(3.0, 3.0, 100.0), velocity_max=(0.3, 0.5, 0.2),
)  # fmt: skip
EVERY_LEE = CrazyflieLeeCfg(
    Kpos_I=(0.5, 0.5, 1.0), KI=(2.0, 2.0, 0.5), Kpos_I_limit=(0.02, 0.01, 0.02), KI_limit=(0.01, 0.01, 0.02)
)
EVERY_BRESCIANINI = BrescianiniCfg(
    rate_hz=250.0, tau_xy=0.2, mixing_factor=0.4, zeta_xy=0.7, coll_min=9.0, coll_max=10.5, omega_rp_max=0.2,
    omega_yaw_max=0.05,
)  # fmt: skip
"""Every part of the Crazyflie's controllers; limits act."""

LATE = {"rate_hz": 50.0, "delay": 0.014}


def change(name: str, **changes: object) -> tuple[ControllerCfg, tuple[str, ...]]:
    return replace(CONTROLLERS.get(name), **changes), ()


QUICK = {"rate_hz": 250.0, "action_delay": 0.004}
CASES = {
    "everything": (BUSY, ()),
    "with effects": (replace(BUSY, law="attitude"), ("gusts", "actuation_delay", "rotor_drag")),
    "no loop": change("lee_velocity_control", rate_hz=100.0, action_delay=0.004),
    "clamped": change("pid_rates_control", allocation="clamp"),
    "all of Betaflight": change("betaflight_rate_control", **LATE, betaflight=TUNED),
    "Betaflight, no airmode": change("betaflight_rate_control", betaflight=replace(TUNED, i_yaw=80.0, airmode=False)),
    "all of Mellinger": change("crazyflie_mellinger_control", **QUICK, mellinger=EVERY_MELLINGER),
    "all of the Crazyflie's PID": change("crazyflie_pid_control", **LATE, crazyflie_pid=EVERY_PID),
    "all of the Crazyflie's Lee": change("crazyflie_lee_control", **QUICK, crazyflie_lee=EVERY_LEE),
    "all of Brescianini": change("crazyflie_brescianini_control", **LATE, brescianini=EVERY_BRESCIANINI),
    "all of PX4": change("px4_position_control", **LATE, px4=FILTERED),
    "PX4 with airmode": change("px4_rate_control", delay=0.014, px4=replace(FILTERED, MC_AIRMODE=1, MC_ROLLRATE_P=2.0)),
}


AS_USERS_HAVE_THEM = "everything"
"""The one whose kernel is optimised; the others keep their loops, as users have them with more than 16 rotors."""


REGISTERED = [name for name in CONTROLLERS.names() if CONTROLLERS.get(name).law != "pose"]
"""Controllers that any quadrotor can have."""


def compare_backends(cfg: ControllerCfg, effects: tuple[str, ...] = ()) -> None:
    """At most 4 times as far from float64 as float32 torch is, and some units in the last place; through a masked reset."""
    exact, single = (fly(TorchBackend(), cfg, dtype, effects=effects)[-1] for dtype in (F64, torch.float32))
    fused = fly(WarpBackend(), cfg, torch.float32, effects=effects)[-1]
    for name, truth in vars(exact).items():
        size = 1.0 + truth.abs().max()
        allowed = 4.0 * (getattr(single, name) - truth).abs().max() / size + 4e-6
        assert (getattr(fused, name) - truth).abs().max() / size <= allowed, name
        assert allowed < 1e-3, name


@pytest.mark.parametrize("case", rare_values(CASES, ("with effects", "no loop", "clamped")))
def test_both_backends_fly_alike(case: str, request: pytest.FixtureRequest) -> None:
    if case == AS_USERS_HAVE_THEM:
        request.getfixturevalue("optimise_kernels")
    compare_backends(*CASES[case])


@pytest.mark.slow
@pytest.mark.parametrize("name", REGISTERED)
def test_both_backends_fly_every_registered_controller_alike(name: str) -> None:
    compare_backends(CONTROLLERS.get(name))


@pytest.mark.parametrize("backend", [TorchBackend, WarpBackend])
def test_a_masked_reset_begins_anew_and_leaves_others_bit_for_bit(backend: type) -> None:
    reset, untouched = backend(), backend()
    vehicle = vehicle_from_config(ROBOT, num_envs=4)
    mask = torch.tensor([True, False, True, False])
    ends = []
    for used in (reset, untouched):
        used.allocate(build_model(vehicle), make_controller(BUSY, vehicle, 9.81, dt=DT), integrator="euler")
        state, action = flight_start(4)
        used.step(state, action, DT, 33)
        ends.append((state, action))
    reset.reset_memory(mask)
    fresh = backend()
    fresh.allocate(build_model(vehicle), make_controller(BUSY, vehicle, 9.81, dt=DT), integrator="euler")
    ends.append((BodyState(**{k: v.clone() for k, v in vars(ends[0][0]).items()}), ends[0][1]))
    for used, (state, action) in zip((reset, untouched, fresh), ends, strict=True):
        used.step(state, action, DT, 33)
    for name in vars(ends[0][0]):
        result, kept, anew = (getattr(state, name) for state, _ in ends)
        assert torch.equal(result[~mask], kept[~mask]), name
        assert torch.equal(result[mask], anew[mask]), name
        if name != "position":
            assert not torch.equal(result[mask], kept[mask]), name


def flight_start(num_envs: int) -> tuple[BodyState, Tensor]:
    state = state_at_rest(num_envs, 4, device=torch.device("cpu"), dtype=torch.float32)
    state.rotor_speed.fill_(rotor_state_for_thrust(ROBOT.rotor, 0.25 * 9.81 / 4))
    state.ang_vel.copy_(0.4 * torch.randn(num_envs, 3, generator=torch.Generator().manual_seed(1)))
    return state, torch.tensor([0.5, -0.3, 0.2, 0.1]).expand(num_envs, -1).contiguous()


def test_an_environment_does_not_depend_on_its_batch() -> None:
    together = fly(WarpBackend(), BUSY, torch.float32)[-1]
    alone = fly(WarpBackend(), BUSY, torch.float32, rows=slice(3, 4))[-1]
    for name, tensor in vars(alone).items():
        assert torch.equal(tensor[0], getattr(together, name)[3]), name


def test_rates_and_delays_that_do_not_fit_are_refused_with_the_nearest() -> None:
    for cfg, message in (
        (replace(PID, rate_loop=RateLoopCfg(rate_hz=300.0)), r"rate_hz = 300 Hz: .* 1.66667 physics .*250 Hz"),
        (replace(PID, rate_loop=RateLoopCfg(rate_hz=1000.0)), r"rate_hz = 1000 Hz: .* 0.5 physics steps.*500 Hz"),
        (replace(PID, action_delay=0.003), r"action_delay = 0.003 s: .* 1.5 physics steps.*0.004 s"),
        (replace(PID, rate_hz=100.0, rate_loop=RateLoopCfg(rate_hz=250.0)), r"rate loop runs at 250.0 Hz, .* multiple"),
    ):
        assert_refused(ConfigError, message, make_timing, cfg, DT)
    with pytest.raises(ConfigError, match="there is no rate loop to reach"):
        replace(CONTROLLERS.get("lee_rates_control"), delay=0.01)
    with pytest.raises(ConfigError, match=r"RateLoopCfg.integral = \(-1.0, 0.0, 0.0\): must be >= 0"):
        RateLoopCfg(integral=(-1.0, 0.0, 0.0))


def test_what_a_controller_with_memory_cannot_do_is_said() -> None:
    vehicle = vehicle_from_config(ROBOT, num_envs=1)
    assert_refused(ConfigError, r"needs a time step. Give dt", make_controller, PID, vehicle, 9.81)
    for backend in (TorchBackend(), WarpBackend()):
        backend.allocate(build_model(vehicle), make_controller(PID, vehicle, 9.81, dt=DT), integrator="euler")
        state, action = flight_start(1)
        with pytest.raises(ConfigError, match=r"built for steps of 0.002 s, but the physics takes 0.01 s"):
            backend.step(state, action, 0.01, 1)
    law = make_controller(PID, vehicle, 9.81, dt=DT)
    with pytest.raises(CapabilityError, match="cannot run CascadeController, which has memory"):
        WarpBackend(differentiable=True).allocate(build_model(vehicle), law, integrator="euler")


def test_gains_of_each_environment_are_read_by_both_backends() -> None:
    ends = []
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(ROBOT, num_envs=3)
        law = make_controller(PID, vehicle, 9.81, dt=DT)
        law.own_gains()
        law.rate_gains.proportional.mul_(torch.tensor([[0.5], [1.0], [1.5]]))
        backend.allocate(build_model(vehicle), law, integrator="euler")
        state, action = flight_start(3)
        state.ang_vel.copy_(state.ang_vel[:1].expand(3, 3).clone())
        backend.step(state, action, DT, 30)
        ends.append(state.ang_vel)
    torch.testing.assert_close(ends[1], ends[0], rtol=2e-5, atol=2e-5)
    assert not torch.allclose(ends[0][0], ends[0][2], atol=1e-2)
