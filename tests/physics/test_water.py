"""Effects under water against closed forms and conservation laws, float64; and the registered ``base_rov`` with its
own. The hull has 2 kg and (0.02, 0.03, 0.05) kg m²; rotors stand still."""

from dataclasses import replace
from itertools import pairwise
from math import cos, exp, log2, pi, sin, sqrt, tanh

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate, quat_rotate_inverse
from aerial_gym.physics import EFFECTS, INTEGRATORS, BodyState, advance, build_model, vehicle_from_config
from aerial_gym.physics.model import Model
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_load
from tests.physics.test_slung_payload import random_load
from tests.physics.vehicles import F64, SpeedControl, make_effects
from tests.repetitions import thin_values

MASS, INERTIA, G = 2.0, (0.02, 0.03, 0.05), 9.81
ADDED = {"x": 1.0, "y": 3.0, "z": 5.0}
TURNED = {"x": 0.01, "y": 0.02, "z": 0.04}
NO_DRAG = {f"{letter}{axis}": 0.0 for letter in "lqab" for axis in "xyz"}


def hull(
    effects: dict[str, dict[str, float]], *, com: tuple[float, float, float] = (0.0, 0.0, 0.0), **options: float
) -> Model:
    robot = ROBOTS.get("lmf1")
    rows = tuple(tuple(INERTIA[i] if i == j else 0.0 for j in range(3)) for i in range(3))
    robot = replace(robot, body=replace(robot.body, mass=MASS, inertia=rows, com=com))
    return build_model(vehicle_from_config(robot, num_envs=1, dtype=F64), make_effects(effects, 1), **options)


def make_state(rotors: int = 4, **parts: tuple[float, ...]) -> BodyState:
    rows = {name: torch.tensor([values], dtype=F64) for name, values in parts.items()}
    euler = rows.pop("euler", torch.zeros(1, 3, dtype=F64))
    rest = {name: torch.zeros(1, 3, dtype=F64) for name in ("position", "lin_vel", "ang_vel")}
    return BodyState(**(rest | rows), attitude=quat_from_euler(euler), rotor_speed=torch.zeros(1, rotors, dtype=F64))


def propagate(model: Model, state: BodyState, span: float, *, steps: int = 200) -> BodyState:
    still = torch.zeros_like(state.rotor_speed)
    return advance(model, INTEGRATORS["rk4"], SpeedControl(), state, still, span / steps, steps)


def test_a_sinking_hull_reaches_its_terminal_speed() -> None:
    """Weight less buoyancy is q v² (with l = 0), approached as ``v = u tanh(k t)``, ``k = q u / (m + z)``."""
    push, drag = MASS * G - 15.0, NO_DRAG | {"qz": 8.0}
    model = hull({"buoyancy": {"force": 15.0, "x": 0.0, "y": 0.0, "z": 0.0}, "hull_drag": drag, "added_mass": ADDED})
    speed = sqrt(push / 8.0)
    for span in (0.4, 20.0):
        expected = -speed * tanh(8.0 * speed * span / (MASS + ADDED["z"]))
        assert propagate(model, make_state(), span).lin_vel[0, 2].item() == pytest.approx(expected, rel=1e-9)


def test_linear_and_quadratic_drag_balance_a_weight() -> None:
    """``l v + q v² = m g - B``: the positive root, along body x of a hull that hangs nose down."""
    drag = NO_DRAG | {"lx": 4.0, "qx": 9.0, "ly": 50.0}
    model = hull({"hull_drag": drag, "buoyancy": {"force": 10.0, "x": 0.0, "y": 0.0, "z": 0.0}})
    end = propagate(model, make_state(euler=(0.0, pi / 2, 0.0)), 20.0, steps=400)
    push = MASS * G - 10.0
    assert -end.lin_vel[0, 2].item() == pytest.approx((sqrt(16.0 + 36.0 * push) - 4.0) / 18.0, rel=1e-9)


@pytest.mark.parametrize("axis", thin_values([2, 0, 1], 3))
def test_a_turning_hull_is_slowed_about_each_axis(axis: int) -> None:
    """Linear: ``w exp(-a t / J)``; quadratic: ``w / (1 + w b t / J)``; J with the water that turns along."""
    name, inertia, start = "xyz"[axis], INERTIA[axis] + TURNED["xyz"[axis]], 3.0
    turning = tuple(start if i == axis else 0.0 for i in range(3))
    for letter, expected in (
        ("a", start * exp(-0.02 * 2.0 / inertia)),
        ("b", start / (1.0 + start * 0.02 * 2.0 / inertia)),
    ):
        model = hull({"hull_drag": NO_DRAG | {f"{letter}{name}": 0.02}, "added_inertia": TURNED}, gravity=0.0)
        end = propagate(model, make_state(ang_vel=turning), 2.0)
        assert end.ang_vel[0, axis].item() == pytest.approx(expected, rel=1e-9)


def test_a_neutral_hull_swings_like_a_pendulum() -> None:
    """Small angles: ``cos(w t)`` with ``w² = B h / (J + J_A)``; h between the centres, wherever the origin is."""
    effects = {"buoyancy": {"force": MASS * G, "x": 0.0, "y": 0.0, "z": 0.05}, "added_inertia": TURNED}
    model, angle, span = hull(effects, com=(0.0, 0.0, -0.15)), 1e-4, 1.0
    end = propagate(model, make_state(euler=(angle, 0.0, 0.0)), span, steps=500)
    frequency = sqrt(MASS * G * 0.2 / (INERTIA[0] + TURNED["x"]))
    roll = 2.0 * end.attitude[0, 0].item()
    assert roll == pytest.approx(angle * cos(frequency * span), abs=1e-6 * angle)


def test_a_current_carries_all_bodies() -> None:
    """In the frame of the water the same happens: Galileo."""
    effects = {"added_mass": ADDED, "added_inertia": TURNED, "hull_drag": dict.fromkeys(NO_DRAG, 0.3)}
    effects["buoyancy"] = {"force": 12.0, "x": 0.02, "y": 0.0, "z": 0.05}
    current = torch.tensor([[0.7, -0.4, 0.2]], dtype=F64)
    moving = {"constant_wind": {"x": 0.7, "y": -0.4, "z": 0.2}}
    start = make_state(euler=(0.3, 0.2, -0.5), lin_vel=(0.5, 0.0, 0.1), ang_vel=(0.5, -1.0, 1.0))
    still = propagate(hull(effects), start, 2.0)
    carried = propagate(hull(effects | moving), replace(start, lin_vel=start.lin_vel + current), 2.0)
    torch.testing.assert_close(carried.lin_vel, still.lin_vel + current, rtol=0.0, atol=1e-10)
    torch.testing.assert_close(carried.position, still.position + 2.0 * current, rtol=0.0, atol=1e-10)
    torch.testing.assert_close(carried.attitude, still.attitude, rtol=0.0, atol=1e-10)


def test_a_rolled_hull_falls_along_the_axis_of_its_lesser_added_mass() -> None:
    """Rolled by p, world z is (0, sin p, cos p) in body axes: ``a_i = -(m g - B) up_i / (m + M_i)``, turned back."""
    model = hull({"buoyancy": {"force": 5.0, "x": 0.0, "y": 0.0, "z": 0.0}, "added_mass": ADDED})
    end = propagate(model, make_state(euler=(0.7, 0.0, 0.0)), 1e-6, steps=1)
    y, z = (-(MASS * G - 5.0) * up / (MASS + ADDED[axis]) for axis, up in (("y", sin(0.7)), ("z", cos(0.7))))
    expected = [[0.0, cos(0.7) * y - sin(0.7) * z, sin(0.7) * y + cos(0.7) * z]]
    torch.testing.assert_close(end.lin_vel / 1e-6, torch.tensor(expected, dtype=F64), rtol=1e-8, atol=1e-8)


def test_water_is_not_looked_for_in_flights_and_one_fluid_is_enough() -> None:
    assert {name for name in EFFECTS.names() if EFFECTS.get(name).medium == "water"} == {
        "added_inertia", "added_mass", "buoyancy", "hull_drag", "link_added_mass", "link_buoyancy",
    }  # fmt: skip
    assert not any(
        EFFECTS.get(name).is_candidate_of_selection
        for name in ("added_mass", "hull_drag", "gusts", "motor_failure", "stuck_rotor")
    )
    twice = make_effects({"added_mass": ADDED}, 1) * 2
    with pytest.raises(ConfigError, match="a vehicle has one fluid at most"):
        build_model(vehicle_from_config(ROBOTS.get("lmf1"), num_envs=1, dtype=F64), twice)


def test_the_water_of_base_rov_is_that_of_its_nine_spheres() -> None:
    """A hull of 0.3 kg and eight motors of 0.1 kg, each displacing its mass of water; to the four digits of the file."""
    spheres = [(0.3, 0.0)] + [(0.1, sqrt(2.0) * 0.1732051)] * 8  # mass [kg], distance from each axis [m]
    radius = {mass: (3.0 * mass / (4.0 * pi * 1000.0)) ** (1 / 3) for mass, _ in spheres}
    of_area = 0.5 * 1000.0 * 0.47 * pi
    derived = {
        "l": sum(6.0 * pi * 1e-3 * radius[m] for m, _ in spheres),
        "q": sum(of_area * radius[m] ** 2 for m, _ in spheres),
        "a": sum(6.0 * pi * 1e-3 * radius[m] * arm**2 + 8.0 * pi * 1e-3 * radius[m] ** 3 for m, arm in spheres),
        "b": sum(of_area * radius[m] ** 2 * arm**3 for m, arm in spheres),
    }
    effects = ROBOTS.get("base_rov").effects
    assert effects["hull_drag"] == pytest.approx({f"{k}{i}": derived[k] for k in "lqab" for i in "xyz"}, rel=3e-4)
    assert effects["added_mass"] == pytest.approx(dict.fromkeys("xyz", sum(0.5 * m for m, _ in spheres)), rel=3e-4)
    turned = sum(0.5 * m * arm**2 for m, arm in spheres)
    assert effects["added_inertia"] == pytest.approx(dict.fromkeys("xyz", turned), rel=3e-4)


ENVS = 24


def hull_in_rotation(
    effects: dict[str, dict[str, float]], *, seed: int, gravity: float = 0.0, envs: int = ENVS
) -> Model:
    """Return a hull of 4 kg with a skew inertia, and its centre of mass beside the origin."""
    draw = torch.Generator().manual_seed(seed)
    axes = torch.linalg.qr(torch.randn(3, 3, dtype=F64, generator=draw))[0]
    moments = torch.tensor([0.05, 0.08, 0.1], dtype=F64) * (1.0 + 0.2 * torch.rand(3, dtype=F64, generator=draw))
    inertia = axes @ moments.diag() @ axes.T
    robot = ROBOTS.get("lmf1")
    rows = tuple(map(tuple, (0.5 * (inertia + inertia.T)).tolist()))
    robot = replace(robot, body=replace(robot.body, mass=4.0, inertia=rows, com=(0.05, -0.03, 0.02)))
    return build_model(
        vehicle_from_config(robot, num_envs=envs, dtype=F64), make_effects(effects, envs), gravity=gravity
    )


def tumble_state(rotors: int, *, seed: int, speed: float = 1.0, rate: float = 2.0, envs: int = ENVS) -> BodyState:
    draw = torch.Generator().manual_seed(seed)

    def normal(columns: int) -> Tensor:
        return torch.randn(envs, columns, dtype=F64, generator=draw)

    return BodyState(
        position=normal(3), attitude=torch.nn.functional.normalize(normal(4), dim=-1), lin_vel=speed * normal(3),
        ang_vel=rate * normal(3), rotor_speed=torch.zeros(envs, rotors, dtype=F64),
    )  # fmt: skip


def fly(model: Model, state: BodyState, span: float, dt: float, integrator: str = "euler") -> BodyState:
    still = torch.zeros_like(state.rotor_speed)
    return advance(model, INTEGRATORS[integrator], SpeedControl(), state, still, dt, round(span / dt))


def invariants(
    model: Model, state: BodyState, added: dict[str, float], current: Tensor, elapsed: float = 0.0
) -> tuple[Tensor, Tensor, Tensor]:
    vehicle = model.vehicle
    lever = quat_rotate(state.attitude, vehicle.com)
    turn = quat_rotate(state.attitude, state.ang_vel)
    place = state.position + lever - elapsed * current
    v = quat_rotate_inverse(state.attitude, state.lin_vel + torch.linalg.cross(turn, lever) - current)
    mass = vehicle.mass[:, None] + torch.tensor([added[axis] for axis in "xyz"], dtype=F64)
    spin = torch.einsum("eij,ej->ei", vehicle.inertia, state.ang_vel)
    impulse = quat_rotate(state.attitude, mass * v)
    moment = quat_rotate(state.attitude, spin) + torch.linalg.cross(place, impulse)
    return 0.5 * (mass * v * v).sum(-1) + 0.5 * (spin * state.ang_vel).sum(-1), impulse, moment


def without_drag(name: str) -> RobotCfg:
    robot = ROBOTS.get(name)
    return replace(robot, effects={key: values for key, values in robot.effects.items() if key != "hull_drag"})


def energy_of_bluerov(state: BodyState) -> tuple[Tensor, Tensor]:
    """Return kinetic energy of the hull and its water, and that with the potential of weight and buoyancy [J], (E,)."""
    robot = ROBOTS.get("bluerov2_heavy")
    force, height, weight = robot.effects["buoyancy"]["force"], robot.effects["buoyancy"]["z"], robot.body.mass * G
    vehicle = vehicle_from_config(robot, num_envs=state.num_envs, dtype=F64)
    still = torch.zeros(3, dtype=F64)
    kinetic = invariants(
        build_model(vehicle, make_effects(robot.effects, state.num_envs)), state, robot.effects["added_mass"], still
    )[0]
    up = torch.zeros_like(state.position)
    up[:, 2] = height
    raised = quat_rotate(state.attitude, up)[:, 2]
    return kinetic, kinetic + (weight - force) * state.position[:, 2] - force * raised


def test_the_bluerov_without_drag_keeps_its_energy() -> None:
    """Weight, buoyancy and its righting moment act. Within 0.1 % in 3 s of 10 ms steps."""
    robot = without_drag("bluerov2_heavy")
    model = build_model(vehicle_from_config(robot, num_envs=ENVS, dtype=F64), make_effects(robot.effects, ENVS))
    start = tumble_state(8, seed=0, speed=0.6, rate=0.6)
    kinetic, before = energy_of_bluerov(start)
    after = energy_of_bluerov(fly(model, start, 3.0, 0.01))[1]
    assert float(((after - before).abs() / kinetic).max()) < 1e-3


@pytest.mark.parametrize(("dt", "hurry"), [(0.005, 1.0), (0.02, 5.0)])
@pytest.mark.parametrize("added", [{"x": 0.3, "y": 6.0, "z": 9.0}, {"x": 12.0, "y": 2.0, "z": 2.0}])
def test_a_free_hull_in_a_current_keeps_energy_impulse_and_moment(
    added: dict[str, float], dt: float, hurry: float
) -> None:
    """Kirchhoff's equations: none is kept if a term or a sign is off. To rounding, at 10 rad/s and 20 ms too: explicit
    steps ended in NaN here."""
    current = (0.4, -0.3, 0.2)
    wind = dict(zip("xyz", current, strict=True))
    model = hull_in_rotation({"added_mass": added, "added_inertia": TURNED, "constant_wind": wind}, seed=1)
    start, flow = tumble_state(4, seed=2, speed=hurry, rate=2.0 * hurry), torch.tensor(current, dtype=F64)
    end = fly(model, start, 1.0, dt)
    before, after = invariants(model, start, added, flow), invariants(model, end, added, flow, 1.0)
    assert float((end.ang_vel - start.ang_vel).norm(dim=-1).min()) > 0.1
    for old, new in zip(before, after, strict=True):
        torch.testing.assert_close(new, old, rtol=1e-10, atol=1e-10)


def test_it_converges_to_the_motion_of_rk4_with_order_2() -> None:
    added = {"x": 0.3, "y": 6.0, "z": 9.0}
    model = hull_in_rotation(
        {"added_mass": added, "buoyancy": {"force": 30.0, "x": 0.0, "y": 0.02, "z": 0.1}}, seed=3, gravity=G
    )
    start = tumble_state(4, seed=4)
    exact = fly(model, start, 0.5, 0.0025, "rk4")
    errors = [float((fly(model, start, 0.5, dt).ang_vel - exact.ang_vel).norm()) for dt in (0.02, 0.01, 0.005)]
    for coarse, fine in pairwise(errors):
        assert log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


def test_a_weight_gives_its_impulse() -> None:
    """A weight on a tumbling hull changes the impulse of hull and water by ``m g t``, exactly in each step."""
    added = {"x": 0.3, "y": 6.0, "z": 9.0}
    model, start = hull_in_rotation({"added_mass": added}, seed=5, gravity=G), tumble_state(4, seed=6)
    zero = torch.zeros(3, dtype=F64)
    gained = invariants(model, fly(model, start, 1.0, 0.01), added, zero)[1] - invariants(model, start, added, zero)[1]
    torch.testing.assert_close(gained, torch.tensor([0.0, 0.0, -4.0 * G], dtype=F64).expand(ENVS, 3), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_slung_payload_and_a_hull_exchange_impulse() -> None:
    """Impulse of hull and water and momentum of the payload, ``m_p (v + l n')``, are constant together without weight. Euler
    loses it with order 1, as forces of the payload depend on velocities."""
    added, mass, length = {"x": 0.3, "y": 6.0, "z": 9.0}, 1.5, 0.7
    payload = {"mass": mass, "length": length, "damping": 0.0}
    model, start = hull_in_rotation({"added_mass": added, "slung_payload": payload}, seed=7), tumble_state(4, seed=8)
    load, still = random_load(ENVS), torch.zeros(3, dtype=F64)

    def invariant_loss(integrator: str, steps: int) -> Tensor:
        end, swung = fly_load(model, start, load, 0.25, steps, integrator)
        hulls = [invariants(model, state, added, still)[1] for state in (start, end)]
        payloads = [mass * (s.lin_vel + length * link[:, 3:]) for s, link in ((start, load), (end, swung))]
        assert float((hulls[1] - hulls[0]).norm(dim=-1).mean()) > 0.5
        return (hulls[1] - hulls[0] + payloads[1] - payloads[0]).norm(dim=-1)

    assert float(invariant_loss("rk4", 175).max()) < 1e-6
    coarse, fine = invariant_loss("euler", 62), invariant_loss("euler", 124)
    assert log2(float(coarse.mean() / fine.mean())) == pytest.approx(1.0, abs=0.1)
