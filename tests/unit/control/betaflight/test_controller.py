"""Betaflight's rate loop: rates, filters, integral, attenuation and mixer, each against what it must do exactly. Its
Warp twin is held to torch in ``test_cascade.py``."""

from dataclasses import replace
from math import cos, pi, radians, sqrt

import pytest
import torch

from aerial_gym.config.autopilots import SCALES, BetaflightCfg
from aerial_gym.config.controller import RateLoopCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, check_closed_loop, make_controller
from aerial_gym.control.betaflight.controller import (
    RELAXED_FROM,
    BetaflightController,
    anti_windup_factor,
    mix_signals,
    rate_setpoint_of_stick,
    throttle_attenuation,
)
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState, state_at_rest, vehicle_from_config
from aerial_gym.physics.law_memory import LawMemory, fresh_law_memory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS

F64 = torch.float64
RACER = ROBOTS.get("racing_quadrotor")
DT = 0.001
NAME = "betaflight_rate_control"
PLAIN = BetaflightCfg(
    dterm_lpf1_static_hz=0.0, dterm_lpf2_static_hz=0.0, iterm_relax="OFF", i_roll=0.0, p_roll=0.0, i_pitch=0.0, p_pitch=0.0,
    i_yaw=0.0, p_yaw=0.0,
)  # fmt: skip


def make_law(own: BetaflightCfg | None = None, robot: RobotCfg = RACER, dt: float = DT) -> BetaflightController:
    cfg = replace(CONTROLLERS.get(NAME), **({} if own is None else {"betaflight": own}))
    return make_controller(cfg, vehicle_from_config(robot, num_envs=1, dtype=F64), 9.81, dt=dt)


def sides(axis: int) -> torch.Tensor:
    """Return 1 for each rotor on the positive side of an axis, else -1, (R,)."""
    return torch.tensor([1.0 if mount.position[axis] > 0 else -1.0 for mount in RACER.mounts.layout], dtype=F64)


def rest_state(ang_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> BodyState:
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=F64)
    return replace(state, ang_vel=torch.tensor([ang_vel], dtype=F64))


def run(
    law: BetaflightController, actions: list[list[float]], states: list[BodyState] | None = None
) -> tuple[torch.Tensor, LawMemory]:
    """Return motor signals, 0 to 1, of each run, (T, R), and the last memory."""
    memory, result = fresh_law_memory(law.needs, 1, rest_state().position), []
    for k, action in enumerate(actions):
        state = rest_state() if states is None else states[k]
        command, memory = law.command(state, torch.tensor([action], dtype=F64), memory)
        result.append(((command - law._low) / law._span)[0])
    return torch.stack(result), memory


def test_a_largest_rate_below_that_about_the_centre_has_no_effect() -> None:
    rows = (torch.full((1, 3), value, dtype=F64) for value in (0.5, 4.0, 3.0, 0.5))
    assert rate_setpoint_of_stick(*rows).tolist() == [[2.0, 2.0, 2.0]]


def test_relax_and_windup_multiply_on_yaw() -> None:
    """A change of half the rate of full relaxation, and half of the range above the start of the windup."""
    change, used = torch.full((1, 3), 0.5 * RELAXED_FROM, dtype=F64), torch.full((1, 1), 0.9, dtype=F64)
    assert anti_windup_factor(change, used, 0.8)[0].tolist() == pytest.approx([0.5, 0.5, 0.25])


def test_actual_rates_are_those_of_the_public_calculators() -> None:
    """Default 70, 670, 0: 35 + 600 / 4 = 185 deg/s at half stick, 670 at full; expo 0.5 halves the square and adds x⁶ / 2."""

    def rates(stick: list[float], center: float, largest: float, expo: float = 0.0) -> list[float]:
        numbers = (torch.full((1, 3), value, dtype=F64) for value in (radians(center), radians(largest), expo))
        return rate_setpoint_of_stick(torch.tensor([stick], dtype=F64), *numbers).rad2deg()[0].tolist()

    half = 35.0 + 600.0 * (0.5 * 0.25 + 0.5 * 0.5**6)
    assert rates([0.5, 1.0, -0.5], 70.0, 670.0) == pytest.approx([185.0, 670.0, -185.0])
    assert rates([0.5, 1.0, -0.5], 70.0, 670.0, 0.5) == pytest.approx([half, 670.0, -half])
    # The firmware's limit is 1998 deg/s.
    assert rates([1.0, -1.0, 0.5], 0.0, 3000.0) == pytest.approx([1998.0, -1998.0, 750.0])
    assert rates([1e-6] * 3, 70.0, 670.0) == pytest.approx([70e-6] * 3, rel=1e-4)


def test_sticks_ask_for_their_rates() -> None:
    rates = make_law(replace(PLAIN, p_roll=45.0))
    sticks = make_law(replace(PLAIN, p_roll=45.0, rates_type="ACTUAL"))
    assert sticks.action_names[1].startswith("roll stick")
    by_rate, _ = run(rates, [[0.0, radians(185.0), 0.0, 0.0]])
    by_stick, _ = run(sticks, [[0.0, 0.5, 0.0, 0.0]])
    torch.testing.assert_close(by_stick, by_rate)


def test_a_gain_is_worth_what_its_scale_says() -> None:
    """P = 45, 100 deg/s: 45 * 0.032029 * 100 = 144 thousandths of the range, up on the left and down on the right."""
    signal, _ = run(make_law(replace(PLAIN, p_roll=45.0)), [[0.0, radians(100.0), 0.0, 0.0]])
    hover, _ = run(make_law(PLAIN), [[0.0, 0.0, 0.0, 0.0]])
    torch.testing.assert_close(signal - hover, (0.1441305 * sides(1)).unsqueeze(0), atol=1e-6, rtol=0.0)


def test_throttle_zero_is_the_weight() -> None:
    law = make_law()
    command = law.rotor_command(rest_state(), torch.zeros(1, 4, dtype=F64))
    lift = rotor_thrust(law.allocation.vehicle, command).sum()
    assert lift == pytest.approx(RACER.body.mass * 9.81)


def test_feed_forward_and_derivative_are_slopes() -> None:
    """A wanted rate that grows by 3 rad/s² and a body that does, with F = 100 and D = 30: shares of 3 times their worth."""
    steps = 4
    told = [[0.0, 3.0 * DT * k, 0.0, 0.0] for k in range(steps)]
    hover, _ = run(make_law(PLAIN), [[0.0] * 4])
    forward, _ = run(make_law(replace(PLAIN, f_roll=100.0)), told)
    left = sides(1)
    torch.testing.assert_close(forward[0], hover[0])
    torch.testing.assert_close(forward[1:] - hover, (300.0 * SCALES["f"] * left).expand(steps - 1, -1))
    turning = [rest_state((3.0 * DT * k, 0.0, 0.0)) for k in range(steps)]
    slowed, _ = run(make_law(replace(PLAIN, d_roll=30.0, tpa_rate=0.0)), [[0.0] * 4] * steps, turning)
    torch.testing.assert_close(slowed[1:] - hover, (-90.0 * SCALES["d"] * left).expand(steps - 1, -1))


@pytest.mark.parametrize(("kind", "size"), [("PT1", None), ("BIQUAD", sqrt(0.5))])
def test_filters_have_their_cutoffs(kind: str, size: float | None) -> None:
    """A sine at 60 Hz through a gyro filter of 60 Hz: ``1 / sqrt 2`` of a biquad; of PT1 what its recursion gives at 1 kHz,
    which is within 20 % of that. A constant passes, from the first sample on."""
    law = make_law(replace(PLAIN, p_roll=45.0, p_pitch=45.0, gyro_lpf1_type=kind, gyro_lpf1_static_hz=60.0))
    phase = 2.0 * pi * 0.06 * torch.arange(500, dtype=F64)
    wave = [rest_state((value, 0.01, 0.0)) for value in (sqrt(2.0) * 0.01 * phase.sin()).tolist()]
    signal, _ = run(law, [[0.0] * 4] * 500, wave)
    torch.testing.assert_close(signal.sum(-1), signal.sum(-1)[:1].expand(500), atol=1e-9, rtol=0.0)
    roll, pitch = ((signal * sides(axis)).mean(-1) / (45.0 * SCALES["p"]) for axis in (1, 0))
    result = float(roll[-250:].square().mean().sqrt()) / 0.01
    share = DT / (DT + 1.0 / (2.0 * pi * 60.0))
    recursion = share / sqrt(1.0 - 2.0 * (1.0 - share) * cos(2.0 * pi * 0.06) + (1.0 - share) ** 2)
    assert result == pytest.approx(recursion if size is None else size, rel=1e-3)
    assert result == pytest.approx(sqrt(0.5), rel=0.2)
    torch.testing.assert_close(pitch, pitch[:1].expand(500), atol=1e-9, rtol=0.0)
    assert abs(float(pitch[0])) == pytest.approx(0.01)


def test_the_integral_grows_by_its_gain_and_rests_where_the_wanted_rate_changes() -> None:
    """Error of 0.1 rad/s for 10 runs: 10 * 80 * worth * 0.1 * dt. Relaxed, a step of 2 rad/s (115 deg/s) lets it rest until the
    low-pass of 15 Hz has come within 40 deg/s: ``ln(115 / 40) / (2 pi 15) = 11 ms``."""
    free = replace(PLAIN, i_roll=80.0)
    _, memory = run(make_law(free), [[0.0, 0.1, 0.0, 0.0]] * 10)
    assert float(memory.numbers[0, 0]) == pytest.approx(10 * 80.0 * SCALES["i"] * 0.1 * DT)
    relaxed = make_law(replace(free, iterm_relax="RP"))
    told = [[0.0, 0.0, 0.0, 0.0]] + [[0.0, 2.0, 0.0, 0.0]] * 40
    resting = []
    for runs in range(2, 41):
        _, memory = run(relaxed, told[:runs])
        resting.append(float(memory.numbers[0, 0]))
    begins = next(k for k, value in enumerate(resting) if value > 0.0)
    assert DT * begins == pytest.approx(0.0112, abs=1.5 * DT)


def test_a_yaw_integral_gain_counts_two_and_a_half_times() -> None:
    """An error of 0.1 rad/s for 10 ms with I = 80: 80 * 0.244381 * 5.729578 * 0.01 = 1.120160 thousandths; 2.800400 for yaw."""
    law = make_law(replace(PLAIN, i_roll=80.0, i_pitch=80.0, i_yaw=80.0))
    _, memory = run(law, [[0.0, 0.1, 0.1, 0.1]] * 10)
    expected = torch.tensor([1.120160e-3, 1.120160e-3, 2.800400e-3], dtype=F64)
    torch.testing.assert_close(memory.numbers[0, :3], expected, rtol=1e-6, atol=0.0)


def test_windup_slows_the_integral_of_yaw_alone_and_integrals_have_a_limit() -> None:
    empty = torch.zeros(1, 3, dtype=F64)
    for used, share in ((0.5, 1.0), (0.85, 1.0), (0.925, 0.5), (1.0, 0.0), (1.3, 0.0)):
        result = anti_windup_factor(empty, torch.full((1, 1), used, dtype=F64), 0.85)
        torch.testing.assert_close(result, torch.tensor([[1.0, 1.0, share]], dtype=F64))
        assert bool((anti_windup_factor(empty, torch.full((1, 1), used, dtype=F64), 1.0) == 1.0).all())
    own = replace(PLAIN, i_roll=8000.0, i_yaw=8000.0)
    for change, limits in (
        ({"version": "4.5", "iterm_limit": 100.0}, (0.1, 0.1)),
        ({"iterm_windup": 50.0}, (0.25, 0.2)),
    ):
        _, memory = run(make_law(replace(own, **change)), [[0.0, 1.0, 0.0, 1.0]] * 200)
        assert memory.numbers[0, (0, 2)].tolist() == pytest.approx(limits), change


def test_windup_of_older_versions_slows_the_yaw_integral_in_the_loop() -> None:
    """Corrections of P beyond 85 % of the range: the integral of yaw stands still in 4.5, and grows in 4.6."""
    own = replace(PLAIN, p_roll=2000.0, i_yaw=80.0, pidsum_limit=1000.0, iterm_windup=85.0)
    for version, grows in (("4.5", False), ("4.6", True)):
        _, memory = run(make_law(replace(own, version=version)), [[0.0, 2.0, 0.0, 0.1]] * 50)
        before = run(make_law(replace(own, version=version)), [[0.0, 2.0, 0.0, 0.1]] * 2)[1]
        assert bool(memory.numbers[0, 2] > before.numbers[0, 2]) is grows


def legacy_mixer(throttle: float, mix: list[float], airmode: bool) -> list[float]:
    """Return the motor signals of Betaflight's LEGACY mixer, number by number, from its rule in ``mixer.c`` (4.3 to 4.5)."""
    high, low = max([0.0, *mix]), min([0.0, *mix])
    share = 1.0 if airmode or throttle >= 0.5 else 0.5 + throttle
    if high - low > 1.0:
        share /= high - low
    throttle = min(max(throttle, -low * share), max(1.0 - high * share, -low * share))
    return [min(max(throttle + share * one, 0.0), 1.0) for one in mix]


def test_the_mixer_is_betaflights_at_random_inputs() -> None:
    """400 mixes of 4 or 6 motors, of any sign and up to twice the range, on torch; the twin is held to torch elsewhere."""
    g = torch.Generator().manual_seed(0)
    for case in range(400):
        motors = 4 + 2 * (case % 2)
        throttle = float(torch.rand(1, generator=g, dtype=F64))
        mix = torch.randn(motors, generator=g, dtype=F64) * 0.4 + (0.6 if case % 7 == 0 else 0.0)
        airmode = case % 3 == 0
        result, used = mix_signals(torch.full((1, motors), throttle, dtype=F64), mix.unsqueeze(0), airmode=airmode)
        assert float(used) == pytest.approx(max(0.0, float(mix.max())) - min(0.0, float(mix.min())))
        torch.testing.assert_close(result[0], torch.tensor(legacy_mixer(throttle, mix.tolist(), airmode), dtype=F64))


def test_without_airmode_zero_throttle_holds_the_integrals_at_zero() -> None:
    """At 0.5 of the weight they grow; at none they are zero again, and with airmode they stay."""
    own = replace(PLAIN, i_roll=80.0, i_yaw=80.0)
    told = [[-0.5, 0.1, 0.0, 0.1]] * 5
    for airmode, kept in ((False, False), (True, True)):
        law = make_law(replace(own, airmode=airmode))
        assert bool((run(law, told)[1].numbers[0, [0, 2]] > 0.0).all())
        assert bool((run(law, [*told, [-1.0, 0.1, 0.0, 0.1]])[1].numbers[0, [0, 2]] > 0.0).all()) is kept


def test_in_the_loop_airmode_turns_the_vehicle_at_no_throttle() -> None:
    """Thrust 0 and 100 deg/s with P = 45: the differences of the signals are those at hover; without it half of them."""
    for airmode, share in ((True, 1.0), (False, 0.5)):
        law = make_law(replace(PLAIN, p_roll=45.0, airmode=airmode))
        signal, _ = run(law, [[-1.0, radians(100.0), 0.0, 0.0]])
        assert float(signal.max() - signal.min()) == pytest.approx(share * 2 * 0.1441305, abs=1e-6)


def test_attenuation_begins_at_its_breakpoint() -> None:
    """65 % at full throttle from 1350 on: at 1675 half of it."""
    for throttle, factor in ((0.2, 1.0), (0.35, 1.0), (0.675, 0.675), (1.0, 0.35)):
        result = throttle_attenuation(torch.full((1, 4), throttle, dtype=F64), 0.65, 0.35)
        assert float(result) == pytest.approx(factor)


def test_corrections_are_limited() -> None:
    signal, _ = run(make_law(replace(PLAIN, p_roll=1000.0, pidsum_limit=100.0)), [[0.0, 3.0, 0.0, 0.0]])
    assert float(signal.max() - signal.min()) == pytest.approx(0.2)


def test_derived_gains_are_those_of_the_other_rate_loop() -> None:
    """For small errors about hover the first answer is that of ``pid_rates_control``: the same torque per rate error."""
    size = 1e-4
    cfg = replace(CONTROLLERS.get("pid_rates_control"), rate_loop=RateLoopCfg(integral=(0.0, 0.0, 0.0)))
    pid = make_controller(cfg, vehicle_from_config(RACER, num_envs=1, dtype=F64), 9.81, dt=DT)
    own = BetaflightCfg(i_roll=0.0, i_pitch=0.0, i_yaw=0.0)
    for axis in range(3):
        action = torch.zeros(1, 4, dtype=F64)
        hover = make_law(own).rotor_command(rest_state(), action)
        action[0, 1 + axis] = size
        expected = pid.rotor_command(rest_state(), action) - hover
        result = make_law(own).rotor_command(rest_state(), action) - hover
        torch.testing.assert_close(result, expected, rtol=1e-3, atol=1e-9)


def with_rotor_lag(seconds: float) -> RobotCfg:
    return replace(RACER, rotor=replace(RACER.rotor, time_constant_up=seconds, time_constant_down=seconds))


OWN = BetaflightCfg(
    p_roll=45.0, i_roll=80.0, d_roll=40.0, f_roll=120.0, p_pitch=47.0, i_pitch=84.0, d_pitch=46.0, f_pitch=125.0,
    p_yaw=45.0, i_yaw=80.0, f_yaw=120.0, gyro_lpf1_static_hz=250.0, gyro_lpf2_static_hz=500.0,
)  # fmt: skip
"""The defaults of 4.5 with their filters."""


def test_betaflights_own_gains_fly_a_racer() -> None:
    """Rotors with a lag of 20 ms; stable at steps of 1 ms."""
    cfg = replace(CONTROLLERS.get(NAME), betaflight=OWN)
    check_closed_loop(with_rotor_lag(0.02), cfg, gravity=9.81, dt=0.001, integrator="rk4", names=("racer", NAME))


@pytest.mark.parametrize(("lag", "rests"), [(0.028, True), (0.031, False)])
def test_yaw_rests_where_routh_says(lag: float, rests: bool) -> None:
    """P + I / s on a first-order lag and an inertia is stable if the lag is below P / I, whatever the loop gain. P / I
    of yaw is ``45 * 0.032029 / (80 * 0.244381 * 2.5)`` = 29.5 ms; with the unit of roll it would be 73.7 ms."""
    own = BetaflightCfg(p_yaw=45.0, i_yaw=80.0)
    cfg = replace(CONTROLLERS.get(NAME), betaflight=own)
    loop = ClosedLoop(with_rotor_lag(lag), cfg, gravity=9.81, integrator="rk4", names=("racer", NAME))
    assert (loop.spectral_radius(2e-4) < 1.0) is rests


def test_what_it_cannot_fly_is_refused_by_name() -> None:
    for robot in ("omnidirectional_octarotor", "base_random"):
        with pytest.raises(ConfigError, match="motors turn in one direction"):
            make_law(robot=ROBOTS.get(robot))
    attitude = replace(CONTROLLERS.get("lee_attitude_control"), betaflight=BetaflightCfg())
    with pytest.raises(ConfigError, match="Betaflight's rate loop follows body rates only"):
        make_controller(attitude, vehicle_from_config(RACER, num_envs=1), 9.81, dt=DT)
    with pytest.raises(ConfigError, match=r"gyro_lpf1_static_hz = 600: must be below half of the loop's 1000 Hz"):
        make_law(BetaflightCfg(gyro_lpf1_type="BIQUAD", gyro_lpf1_static_hz=600.0))
    with pytest.raises(ConfigError, match="tpa_mode"):
        BetaflightCfg(tpa_mode="X")
    with pytest.raises(ConfigError, match="px4 and betaflight are 2 autopilots"):
        replace(CONTROLLERS.get("px4_rate_control"), betaflight=BetaflightCfg())
