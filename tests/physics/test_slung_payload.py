"""The slung payload against closed forms, conservation laws and its order of convergence."""

from dataclasses import replace
from math import cos, log2, pi, sqrt

import pytest
import torch
from torch import Tensor

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import CapabilityError
from aerial_gym.physics import EFFECTS, BodyState, Model, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.physics.swing import fly_load, momentum_energy
from tests.physics.vehicles import F64, asymmetric_robot, random_state
from tests.repetitions import rare_values

G = 9.81


def make_model(robot, num_envs: int, params: list[float], *, gravity: float = G, name: str = "slung_payload") -> Model:
    vehicle = vehicle_from_config(robot, num_envs=num_envs, dtype=F64)
    rows = torch.tensor(params, dtype=F64).expand(num_envs, -1)
    return build_model(vehicle, [(EFFECTS.get(name), rows)], gravity=gravity)


def rest_load(angle: float) -> Tensor:
    tilt = torch.tensor(angle, dtype=F64)
    zero = torch.zeros((), dtype=F64)
    return torch.stack((tilt.sin(), zero, -tilt.cos(), zero, zero, zero)).unsqueeze(0)


def hover_state(model: Model) -> BodyState:
    weight = (model.vehicle.mass[0] + model.effects[LoadEffect][0][1][0, 0]) * model.gravity
    speed = (weight / 4.0 / model.vehicle.thrust_map[0, 0, 2]).sqrt()
    zeros = torch.zeros(1, 3, dtype=F64)
    attitude = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=F64)
    return BodyState(
        position=zeros, attitude=attitude, lin_vel=zeros, ang_vel=zeros, rotor_speed=speed.expand(1, 4).clone()
    )


def random_load(num_envs: int) -> Tensor:
    g = torch.Generator().manual_seed(1)
    direction = torch.nn.functional.normalize(torch.randn(num_envs, 3, dtype=F64, generator=g), dim=-1)
    rate = torch.randn(num_envs, 3, dtype=F64, generator=g)
    return torch.cat((direction, rate - (rate * direction).sum(-1, keepdim=True) * direction), dim=-1)


@pytest.mark.parametrize(("mass", "length"), [pytest.param(0.1, 0.5, marks=pytest.mark.slow), (1.0, 2.0)])
def test_small_swings_have_the_frequency_of_both_masses(mass: float, length: float) -> None:
    """Below a free vehicle that carries the weight: w² = g / l (1 + m / M); x = x_0 cos w t. Next term of x: x_0²/16."""
    model = make_model(ROBOTS.get("tinyprop"), 1, [mass, length, 0.0])
    frequency = sqrt(G / length * (1.0 + mass / 0.373))
    for share in (0.25, 0.4, 1.0):
        span = share * 2.0 * pi / frequency
        _, end = fly_load(model, hover_state(model), rest_load(1e-4), span, 100)
        assert abs(end[0, 0].item() / 1e-4 - cos(2.0 * pi * share)) < 1e-6


def test_a_rod_swings_like_a_physical_pendulum() -> None:
    """A uniform rod has the inertia m l² / 3 about its joint: w² = 3 g / 2 l (M + m) / (M + m / 4) below a free vehicle."""
    mass, length = 0.4, 1.2
    model = make_model(ROBOTS.get("tinyprop"), 1, [mass, length, 0.0], name="slung_payload_rod")
    frequency = sqrt(1.5 * G / length * (0.373 + mass) / (0.373 + 0.25 * mass))
    for share in (0.25, 0.4, 1.0):
        span = share * 2.0 * pi / frequency
        end, load = fly_load(model, hover_state(model), rest_load(1e-4), span, 100)
        assert abs(load[0, 0].item() / 1e-4 - cos(2.0 * pi * share)) < 1e-6
        assert abs(end.position[0, 2].item()) < 1e-6  # the rotors carry the weight of both


def test_a_still_payload_weighs_on_the_vehicle_like_its_mass() -> None:
    """Straight below, at rest: carried by (M + m) g nothing moves; without the rotors' share of m both sink together."""
    model = make_model(ROBOTS.get("tinyprop"), 1, [0.2, 1.0, 0.0])
    end, load = fly_load(model, hover_state(model), rest_load(0.0), 1.0, 50)
    torch.testing.assert_close(end.position, torch.zeros(1, 3, dtype=F64), atol=1e-12, rtol=0)
    torch.testing.assert_close(load, rest_load(0.0), atol=1e-12, rtol=0)
    start = hover_state(model)
    light = replace(start, rotor_speed=start.rotor_speed * sqrt(0.373 / 0.573))  # carries the vehicle alone
    end, _ = fly_load(model, light, rest_load(0.0), 1.0, 50)
    expected = torch.tensor([[0.0, 0.0, -0.2 / 0.573 * G]], dtype=F64)
    torch.testing.assert_close(end.lin_vel, expected, atol=1e-9, rtol=0)


def test_momentum_and_energy_are_conserved() -> None:
    """No rotors, no drag: momentum in weightlessness, angular momentum, energy also under gravity; all of any tumbling.
    Fourth order: below 1e-7 at 2 ms, for rates of some 5 rad/s over 0.45 s: C (w dt)^4 w t."""
    for gravity in (0.0, G):
        model = make_model(asymmetric_robot(), 8, [0.3, 0.4, 0.0], gravity=gravity)
        start, load = replace(random_state(8), rotor_speed=torch.zeros(8, 4, dtype=F64)), random_load(8)
        end, swung = fly_load(model, start, load, 0.45, 225)
        before, after = momentum_energy(model, start, load), momentum_energy(model, end, swung)
        if gravity == 0.0:
            torch.testing.assert_close(after[0], before[0], atol=1e-7, rtol=0)
            torch.testing.assert_close(after[1], before[1], atol=1e-7, rtol=0)
        torch.testing.assert_close(after[2], before[2], atol=1e-6, rtol=0)
        assert ((swung - load).norm(dim=-1) > 0.1).all()


@pytest.mark.parametrize(("integrator", "order"), [pytest.param("euler", 1.0, marks=pytest.mark.slow), ("rk4", 4.0)])
def test_the_coupled_motion_converges_with_the_order_of_the_stepper(integrator: str, order: float) -> None:
    model = make_model(asymmetric_robot(), 8, [0.3, 0.4, 0.02])
    start, load = random_state(8), random_load(8)
    truth = torch.cat(fly_load(model, start, load, 0.2, 320)[0].tensors()[:4], dim=-1)
    errors = []
    for steps in (160, 320) if integrator == "euler" else (20, 40):
        end, _ = fly_load(model, start, load, 0.2, steps, integrator)
        errors.append((torch.cat(end.tensors()[:4], dim=-1) - truth).norm().item())
    assert abs(log2(errors[0] / errors[1]) - order) < 0.1


def test_damping_keeps_momentum_and_takes_the_energy_of_the_swing() -> None:
    """Without gravity and rotors: dp/dt = 0 and dE/dt = -d l² n'², over 1 ms to its share of a percent."""
    length, damping, span = 0.4, 0.5, 1e-3
    model = make_model(asymmetric_robot(), 8, [0.3, length, damping], gravity=0.0)
    start, load = replace(random_state(8), rotor_speed=torch.zeros(8, 4, dtype=F64)), random_load(8)
    end, swung = fly_load(model, start, load, span, 4)
    before, after = momentum_energy(model, start, load), momentum_energy(model, end, swung)
    torch.testing.assert_close(after[0], before[0], atol=1e-10, rtol=0)
    square = 0.5 * (load[:, 3:].square().sum(-1) + swung[:, 3:].square().sum(-1))
    torch.testing.assert_close((after[2] - before[2]) / span, -damping * length**2 * square, atol=0, rtol=1e-3)


def test_a_payload_in_steady_flight_hangs_straight_down() -> None:
    """Both move at v through the air: nothing drags the payload back, and the vehicle is not slowed down."""
    model = make_model(ROBOTS.get("tinyprop"), 1, [0.2, 1.0, 0.1])
    speed = torch.tensor([[5.0, 0.0, 0.0]], dtype=F64)
    end, load = fly_load(model, replace(hover_state(model), lin_vel=speed), rest_load(0.0), 1.0, 50)
    torch.testing.assert_close(load, rest_load(0.0), atol=1e-12, rtol=0)
    torch.testing.assert_close(end.lin_vel, speed, atol=1e-12, rtol=0)


def test_a_single_state_does_not_tell_the_force() -> None:
    with pytest.raises(
        CapabilityError, match="effect slung_payload: has memory, so one state does not determine its force"
    ):
        accelerations(make_model(asymmetric_robot(), 2, [0.1, 1.0, 0.0]), random_state(2))


LOAD, LENGTH = 0.05, 0.5


def make(
    backend: str, *, num_envs: int = 3, differentiable: bool = False, law: str = "slung_payload", **drawn: RandomizeCfg
) -> EnvManager:
    robot, sim = ROBOTS.get("base_quadrotor_with_payload"), SIMS.get("base_sim_2ms")
    env = simulation(
        replace(robot, effects={law: robot.effects["slung_payload"]}), sim=replace(sim, backend=backend, integrator="rk4"),
        env="empty_env_2ms", num_envs=num_envs, seed=2,
        randomize={f"effects.slung_payload.{name}": each for name, each in drawn.items()},
        differentiable=differentiable,
    )  # fmt: skip
    env.reset()
    return env


TORCH_SLOWLY = [pytest.param("torch", marks=pytest.mark.slow), "warp"]


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_a_load_hangs_below_and_swings_on_its_link(backend: str) -> None:
    """Straight down at the reset; later at the same distance, and its place changes as its velocity says, to ``a dt / 2``."""
    env = make(backend)
    gtd, told = env.gtd, torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1)
    torch.testing.assert_close(gtd["load_position"], gtd["robot_position"] - torch.tensor([0.0, 0.0, LENGTH]))
    torch.testing.assert_close(gtd["load_linvel"], gtd["robot_linvel"])
    for _ in range(100):
        before, velocity = gtd["load_position"].clone(), gtd["load_linvel"].clone()
        env.step(told)
        away = gtd["load_position"] - gtd["robot_position"]
        torch.testing.assert_close(away.norm(dim=-1), torch.full((3,), LENGTH), rtol=1e-5, atol=0.0)
        mean = 0.5 * (velocity + gtd["load_linvel"])
        torch.testing.assert_close((gtd["load_position"] - before) / env.dt, mean, atol=0.03, rtol=0.0)
    assert away[:, :2].norm(dim=-1).min() > 0.01  # it does swing


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_both_bodies_together_fall_as_gravity_and_thrust_say(backend: str) -> None:
    """Without thrust both bodies together lose ``(m + M) g t``, to half a unit in the last place of 8 m/s in each substep."""
    env, off = make(backend), torch.zeros(3, 4)
    gtd, mass = env.gtd, 0.25

    def momentum() -> torch.Tensor:
        return mass * gtd["robot_linvel"] + LOAD * gtd["load_linvel"]

    for _ in range(50):  # until the rotors stand still: exp(-0.5 / 0.04)
        env.step(off)
    before = momentum()
    for _ in range(20):
        env.step(off)
    fallen = torch.tensor([0.0, 0.0, -(mass + LOAD) * env.sim_cfg.gravity * 20 * env.dt]).expand(3, -1)
    torch.testing.assert_close(momentum() - before, fallen, atol=2e-5, rtol=0.0)


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_a_reset_hangs_new_loads_in_the_rows_of_the_mask_alone(backend: str) -> None:
    env = make(backend, length=RandomizeCfg(how="value", low=0.3, high=1.0))
    told, mask = torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1), torch.tensor([True, False, True])
    for _ in range(50):
        env.step(told)
    keys = ("load_position", "load_linvel")
    kept = {key: env.gtd[key].clone() for key in keys}
    lengths = env.gtd["effect_slung_payload"][:, 1].clone()
    env.reset(mask)
    for key in keys:
        assert torch.equal(env.gtd[key][~mask], kept[key][~mask])
    away = env.gtd["load_position"] - env.gtd["robot_position"]
    new = env.gtd["effect_slung_payload"][:, 1]
    assert (new != lengths).tolist() == mask.tolist()
    torch.testing.assert_close(away[mask], torch.stack((0.0 * new, 0.0 * new, -new), dim=-1)[mask])


def test_a_fit_changes_from_a_point_mass_to_a_rod_and_back_with_the_same_swing() -> None:
    """Period of a physical pendulum of length L: that of a point mass at 2 L / 3; 3/4 of its mass hang there."""
    values = {"mass": 0.045, "length": 0.66, "damping": 0.02}
    point, rod = EFFECTS.get("slung_payload"), EFFECTS.get("slung_payload_rod")
    as_rod = rod.start_in_place(point.in_first_law(values))
    assert as_rod == pytest.approx({"mass": 0.06, "length": 0.99, "damping": 0.02})
    assert point.start_in_place(rod.in_first_law(as_rod)) == pytest.approx(values)


@pytest.mark.parametrize("law", rare_values(["slung_payload", "slung_payload_rod"], ["slung_payload_rod"]))
def test_both_backends_and_one_with_gradients_show_the_same_load(law: str) -> None:
    ends = []
    for backend, differentiable in (("torch", False), ("warp", False), ("torch", True)):
        env = make(backend, differentiable=differentiable, law=law)
        for _ in range(20):
            env.step(torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1))
        ends.append(torch.cat((env.gtd["load_position"], env.gtd["load_linvel"]), dim=-1))
    torch.testing.assert_close(ends[1], ends[0], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(ends[2], ends[0], atol=1e-4, rtol=1e-4)


def test_a_robot_without_a_load_has_no_such_keys() -> None:
    env = simulation("base_quadrotor")
    assert "load_position" not in env.gtd
