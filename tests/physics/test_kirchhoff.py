"""A hull with added mass under the Euler integrator: energy, impulse and moment of impulse of hull and water, float64.
Energies and impulses are written out here, so that nothing of the integrator checks itself."""

from dataclasses import replace
from itertools import pairwise
from math import log2

import pytest
import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics import INTEGRATORS, BodyState, advance, build_model, vehicle_from_config
from aerial_gym.physics.model import Model
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_load
from tests.physics.test_slung_payload import random_load
from tests.physics.vehicles import F64, SpeedControl, make_effects

G = 9.81
ENVS = 24


def hull(effects: dict[str, dict[str, float]], *, seed: int, gravity: float = 0.0, envs: int = ENVS) -> Model:
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
    """Weight, buoyancy and its righting moment act. Within 0.1 % in 5 s of 10 ms steps."""
    robot = without_drag("bluerov2_heavy")
    model = build_model(vehicle_from_config(robot, num_envs=ENVS, dtype=F64), make_effects(robot.effects, ENVS))
    start = tumble_state(8, seed=0, speed=0.6, rate=0.6)
    kinetic, before = energy_of_bluerov(start)
    after = energy_of_bluerov(fly(model, start, 5.0, 0.01))[1]
    assert float(((after - before).abs() / kinetic).max()) < 1e-3


@pytest.mark.parametrize(("dt", "hurry"), [(0.005, 1.0), (0.02, 5.0)])
@pytest.mark.parametrize("added", [{"x": 0.3, "y": 6.0, "z": 9.0}, {"x": 12.0, "y": 2.0, "z": 2.0}])
def test_a_free_hull_in_a_current_keeps_energy_impulse_and_moment(
    added: dict[str, float], dt: float, hurry: float
) -> None:
    """To rounding, at 10 rad/s and 20 ms too: explicit steps ended in NaN here."""
    current = (0.4, -0.3, 0.2)
    model = hull({"added_mass": added, "constant_wind": dict(zip("xyz", current, strict=True))}, seed=1)
    start, flow = tumble_state(4, seed=2, speed=hurry, rate=2.0 * hurry), torch.tensor(current, dtype=F64)
    end = fly(model, start, 1.0, dt)
    before, after = invariants(model, start, added, flow), invariants(model, end, added, flow, 1.0)
    assert float((end.ang_vel - start.ang_vel).norm(dim=-1).min()) > 0.1
    for old, new in zip(before, after, strict=True):
        torch.testing.assert_close(new, old, rtol=1e-10, atol=1e-10)


def test_it_converges_to_the_motion_of_rk4_with_order_2() -> None:
    added = {"x": 0.3, "y": 6.0, "z": 9.0}
    model = hull({"added_mass": added, "buoyancy": {"force": 30.0, "x": 0.0, "y": 0.02, "z": 0.1}}, seed=3, gravity=G)
    start = tumble_state(4, seed=4)
    exact = fly(model, start, 0.5, 0.00125, "rk4")
    errors = [float((fly(model, start, 0.5, dt).ang_vel - exact.ang_vel).norm()) for dt in (0.02, 0.01, 0.005)]
    for coarse, fine in pairwise(errors):
        assert log2(coarse / fine) == pytest.approx(2.0, abs=0.1)


def test_a_weight_gives_its_impulse() -> None:
    """A weight on a tumbling hull changes the impulse of hull and water by ``m g t``, exactly in each step."""
    added = {"x": 0.3, "y": 6.0, "z": 9.0}
    model, start = hull({"added_mass": added}, seed=5, gravity=G), tumble_state(4, seed=6)
    zero = torch.zeros(3, dtype=F64)
    gained = invariants(model, fly(model, start, 1.0, 0.01), added, zero)[1] - invariants(model, start, added, zero)[1]
    torch.testing.assert_close(gained, torch.tensor([0.0, 0.0, -4.0 * G], dtype=F64).expand(ENVS, 3), rtol=0, atol=1e-9)


def test_a_slung_payload_and_a_hull_exchange_impulse() -> None:
    """Impulse of hull and water and momentum of the payload, ``m_p (v + l n')``, are constant together without weight. Euler
    loses it with order 1, as forces of the payload depend on velocities."""
    added, mass, length = {"x": 0.3, "y": 6.0, "z": 9.0}, 1.5, 0.7
    payload = {"mass": mass, "length": length, "damping": 0.0}
    model, start = hull({"added_mass": added, "slung_payload": payload}, seed=7), tumble_state(4, seed=8)
    load, still = random_load(ENVS), torch.zeros(3, dtype=F64)

    def invariant_loss(integrator: str, steps: int) -> Tensor:
        end, swung = fly_load(model, start, load, 0.5, steps, integrator)
        hulls = [invariants(model, state, added, still)[1] for state in (start, end)]
        payloads = [mass * (s.lin_vel + length * link[:, 3:]) for s, link in ((start, load), (end, swung))]
        assert float((hulls[1] - hulls[0]).norm(dim=-1).mean()) > 0.5
        return (hulls[1] - hulls[0] + payloads[1] - payloads[0]).norm(dim=-1)

    assert float(invariant_loss("rk4", 500).max()) < 1e-6
    coarse, fine = invariant_loss("euler", 125), invariant_loss("euler", 250)
    assert log2(float(coarse.mean() / fine.mean())) == pytest.approx(1.0, abs=0.1)
