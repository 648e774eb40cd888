"""A payload on the cables of several vehicles: closed forms, conservation laws, impacts, and the slung payload for one vehicle.

The vehicles are free bodies under given forces, moved by semi-implicit Euler like those of the fused kernel.
"""

from itertools import pairwise
from math import cos, log2, pi, sin, sqrt
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from aerial_gym.config.vehicles import PayloadCfg
from aerial_gym.math.quaternion import quat_multiply, quat_rotate
from aerial_gym.physics import Trajectory
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.groups.payload import KEYS_OF_CARRIERS, PayloadOnCables
from tests.physics.swing import fly_load
from tests.physics.test_slung_payload import hover_state, make_model, rest_load

G = 9.81


class Rig:
    """E payloads on the cables of V free bodies each."""

    def __init__(self, num_envs: int, count: int, *, dt: float = 1e-3, gravity: float = 0.0, **cfg: object) -> None:
        self.cfg = PayloadCfg(**{"mass": 0.2, "cable_length": 0.8, "cables": "rigid"} | cfg)  # pyright: ignore
        self.dt, self.gravity, self.shape = dt, gravity, (num_envs, count)
        rows = num_envs * count
        gtd = GlobalTensorDictionary(device=torch.device("cpu"), sizes={"E": num_envs, "V": count})
        mass = 0.3 + 0.1 * torch.arange(count).repeat(num_envs)
        self.bodies = SimpleNamespace(
            mass=mass,
            inertia=torch.diag(torch.tensor([1e-3, 2e-3, 3e-3])).repeat(rows, 1, 1),
            position=torch.zeros(rows, 3),
            attitude=torch.tensor([0.0, 0.0, 0.0, 1.0]).repeat(rows, 1),
            lin_vel=torch.zeros(rows, 3),
            ang_vel=torch.zeros(rows, 3),
            com=torch.zeros(rows, 3),
        )
        given = {key: getattr(self.bodies, name) for name, key in KEYS_OF_CARRIERS.items()}
        self.payload = PayloadOnCables(
            self.cfg, gtd, given | {"crashes": torch.zeros(rows, dtype=torch.bool)},
            Trajectory.zeros(1, rows, device=gtd.device), com=self.bodies.com,
            starts=torch.ones(rows, dtype=torch.bool), gravity=gravity, dt=dt, ground_height=None,
        )  # fmt: skip
        self.payload.hang()

    def fly(self, steps: int, force: Tensor | float = 0.0) -> None:
        """Advance by steps under forces at the centres of mass [N], (B, 3), and gravity."""
        one = self.bodies
        down = torch.tensor([0.0, 0.0, -self.gravity])
        inverse = torch.linalg.inv(one.inertia)
        for _ in range(steps):
            self.payload.begin(1)
            lever = quat_rotate(one.attitude, one.com)
            turning = torch.linalg.cross(one.ang_vel, one.com)
            com, com_vel = one.position + lever, one.lin_vel + quat_rotate(one.attitude, turning)
            com_vel = com_vel + self.dt * (down + force / one.mass.unsqueeze(1))
            spin = (one.inertia @ one.ang_vel.unsqueeze(-1)).squeeze(-1)
            gyro = -(inverse @ torch.linalg.cross(one.ang_vel, spin).unsqueeze(-1)).squeeze(-1)
            one.ang_vel.add_(self.dt * gyro)
            half = 0.5 * self.dt * one.ang_vel
            turn = torch.cat((half, (1.0 - half.square().sum(-1, keepdim=True)).sqrt()), dim=-1)
            one.attitude.copy_(torch.nn.functional.normalize(quat_multiply(one.attitude, turn), dim=-1))
            one.position.copy_(com + self.dt * com_vel - quat_rotate(one.attitude, one.com))
            one.lin_vel.copy_(com_vel - quat_rotate(one.attitude, torch.linalg.cross(one.ang_vel, one.com)))
            self.payload.join(0)

    def anchors(self) -> Tensor:
        """Return the ends of the cables on the vehicles [m], (E, V, 3)."""
        ends = self.bodies.position + quat_rotate(
            self.bodies.attitude, torch.tensor(self.cfg.anchor).expand(len(self.bodies.mass), 3)
        )
        return ends.view(*self.shape, 3)

    def com_and_velocity(self) -> tuple[Tensor, Tensor]:
        """Return place [m] and velocity [m/s] of the centres of mass, (B, 3)."""
        one = self.bodies
        place = one.position + quat_rotate(one.attitude, one.com)
        return place, one.lin_vel + quat_rotate(one.attitude, torch.linalg.cross(one.ang_vel, one.com))

    def lengths(self) -> Tensor:
        return (self.payload.position.unsqueeze(1) - self.anchors()).norm(dim=-1)

    def sums(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return momentum, angular momentum about the origin, (E, 3), and energy, (E,), in float64."""
        one = self.bodies
        mass, inertia, ang_vel, attitude, com, place, speed = (
            each.double()
            for each in (one.mass, one.inertia, one.ang_vel, one.attitude, one.com, one.position, one.lin_vel)
        )
        x = place + quat_rotate(attitude, com)
        v = speed + quat_rotate(attitude, torch.linalg.cross(ang_vel, com))
        spin = (inertia @ ang_vel.unsqueeze(-1)).squeeze(-1)
        p = mass.unsqueeze(1) * v
        energy = 0.5 * (p * v).sum(-1) + 0.5 * (spin * ang_vel).sum(-1) + mass * self.gravity * x[:, 2]
        turning = torch.linalg.cross(x, p) + quat_rotate(attitude, spin)
        load, y, u = self.cfg.mass, self.payload.position.double(), self.payload.lin_vel.double()
        by_env = [each.unflatten(0, self.shape).sum(1) for each in (p, turning, energy)]
        own = (load * u, load * torch.linalg.cross(y, u), 0.5 * load * (u * u).sum(-1) + load * self.gravity * y[:, 2])
        return by_env[0] + own[0], by_env[1] + own[1], by_env[2] + own[2]


def tumble(rig: Rig, speed: float = 1.0) -> None:
    """Give vehicles and payload random velocities."""
    g = torch.Generator().manual_seed(3)
    for velocity in (rig.bodies.lin_vel, rig.payload.lin_vel):
        velocity.copy_(speed * torch.randn(velocity.shape, generator=g))


@pytest.mark.parametrize("cables", ["rigid", "slack"])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_momentum_is_conserved(count: int, cables: str) -> None:
    """Without gravity both momenta stay, by impulses along the lines between two points, over 400 substeps of 2 ms."""
    rig = Rig(16, count, dt=2e-3, cables=cables)
    tumble(rig)
    before = rig.sums()
    rig.fly(400)
    after = rig.sums()
    assert rig.payload.tension.abs().max() > 0.0
    for old, new in zip(before[:2], after[:2], strict=True):
        torch.testing.assert_close(new, old, rtol=0.0, atol=2e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_energy_of_rigid_cables_oscillates_and_does_not_drift(count: int) -> None:
    """First impulses make the velocities fit the cables; from then on the error is of first order in dt, at the least. Of one
    vehicle without gravity only rounding is left."""
    errors = []
    for dt in (8e-3, 4e-3, 2e-3):
        rig = Rig(16, count, dt=dt)
        tumble(rig)
        rig.fly(2)
        start = rig.sums()[2]
        worst = torch.zeros(16, dtype=torch.float64)
        for _ in range(round(0.4 / dt / 5)):
            rig.fly(5)
            worst = torch.maximum(worst, (rig.sums()[2] - start).abs() / start)
        errors.append(float(worst.mean()))
        torch.testing.assert_close(rig.lengths(), torch.full((16, count), 0.8), rtol=0.0, atol=5e-6)
    assert errors[-1] < (1e-6 if count == 1 else 0.01)
    if count > 1:
        assert log2(errors[0] / errors[1]) > 0.9
        assert log2(errors[1] / errors[2]) > 0.9


@pytest.mark.parametrize("cables", ["rigid", "slack"])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_vehicles_that_hover_share_the_weight(count: int, cables: str) -> None:
    """At rest every cable pulls with ``m g / (V cos a)``, if each vehicle also holds against its pull."""
    angle = 0.6
    rig = Rig(2, count, gravity=G, cables=cables, angle=angle)
    pull = 0.2 * G / (count * cos(angle))
    towards = torch.nn.functional.normalize(rig.payload.position.unsqueeze(1) - rig.anchors(), dim=-1).flatten(0, 1)
    thrust = rig.bodies.mass.unsqueeze(1) * torch.tensor([0.0, 0.0, G]) - pull * towards
    place = rig.payload.position.clone()
    rig.fly(50, thrust)
    torch.testing.assert_close(rig.payload.tension, torch.full((2, count), pull), rtol=2e-3, atol=0.0)
    torch.testing.assert_close(rig.payload.position, place, rtol=0.0, atol=1e-5)


def test_small_swings_have_the_frequency_of_both_masses() -> None:
    """Below one free vehicle that carries the weight: w² = g / l (1 + m / M), as the slung payload of a single vehicle."""
    rig = Rig(1, 1, gravity=G, dt=5e-4, angle=0.0)
    frequency = sqrt(G / 0.8 * (1.0 + 0.2 / 0.3))
    rig.payload.position[0] = torch.tensor([0.8 * sin(0.02), 0.0, -0.8 * cos(0.02)])
    force = torch.tensor([[0.0, 0.0, 0.5 * G]])
    flown = 0
    for share in (0.25, 0.5, 1.0):
        steps = round(share * 2.0 * pi / frequency / 5e-4)
        rig.fly(steps - flown, force)
        flown = steps
        swing = (rig.payload.position - rig.bodies.position)[0, 0] / (0.8 * sin(0.02))
        assert float(swing) == pytest.approx(cos(2.0 * pi * share), abs=0.01)


def test_one_vehicle_swings_as_with_the_slung_payload() -> None:
    """A release from 1 rad below a vehicle of constant thrust for 0.6 s: first order in dt towards the effect by RK4."""
    robot = ROBOTS.get("tinyprop")
    mass, load, length = robot.body.mass, 0.2, 0.8
    model = make_model(robot, 1, [load, length, 0.0])
    end, link = fly_load(model, hover_state(model), rest_load(1.0), 0.6, 300)
    expected = torch.cat((end.position, end.position + length * link[:, :3]))
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        rig = Rig(1, 1, gravity=G, dt=dt, angle=0.0)
        rig.bodies.mass.fill_(mass)
        rig.payload.position[0] = torch.tensor([length * sin(1.0), 0.0, -length * cos(1.0)])
        rig.fly(round(0.6 / dt), torch.tensor([[0.0, 0.0, (mass + load) * G]]))
        errors.append(float((torch.cat((rig.bodies.position, rig.payload.position)) - expected).norm()))
    assert errors[-1] < 0.005
    for coarse, fine in pairwise(errors):
        assert log2(coarse / fine) == pytest.approx(1.0, abs=0.15)


def test_a_cable_becomes_taut_by_an_inelastic_impact() -> None:
    """Payload m flies off a vehicle M at rest: nothing pulls before the cable is taut, both move with m v / (m + M) after."""
    rig = Rig(1, 1, cables="slack", dt=1e-3, angle=0.0)
    rig.payload.position[0] = torch.tensor([0.3, 0.0, 0.0])
    rig.payload.lin_vel[0] = torch.tensor([2.0, 0.0, 0.0])
    rig.fly(240)
    assert not rig.bodies.lin_vel.any()
    assert not rig.payload.tension.any()
    before = rig.sums()[2]
    rig.fly(20)
    together = 0.2 * 2.0 / 0.5
    torch.testing.assert_close(rig.bodies.lin_vel[0, 0], torch.tensor(together), rtol=1e-3, atol=0.0)
    torch.testing.assert_close(rig.payload.lin_vel[0, 0], torch.tensor(together), rtol=1e-3, atol=0.0)
    lost = before - rig.sums()[2]
    assert float(lost) == pytest.approx(0.5 * (0.2 * 0.3 / 0.5) * 2.0**2, rel=2e-3)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_slack_cables_never_add_energy(count: int) -> None:
    """Random throws with many impacts: after each of 400 substeps of 1 ms the energy is at most that before it, within the
    first-order oscillation of taut cables; in the end much is lost, and no cable is stretched."""
    rig = Rig(64, count, cables="slack")
    rig.payload.position.add_(0.1)
    tumble(rig, 2.0)
    energy = first = rig.sums()[2]
    for _ in range(80):
        rig.fly(5)
        now = rig.sums()[2]
        assert float(((now - energy) / first).max()) < 5e-3
        energy = now
    assert float((energy / first).mean()) < 0.95
    assert rig.lengths().max() < 0.8 + 5e-6
    assert rig.payload.tension.min() >= 0.0


def test_a_rigid_link_pushes_and_a_cable_does_not() -> None:
    for cables, pushes in (("rigid", True), ("slack", False)):
        rig = Rig(1, 2, cables=cables)
        rig.payload.lin_vel[0, 2] = 1.0  # towards the vehicles above
        rig.fly(1)
        assert bool((rig.payload.tension < 0.0).all()) == pushes
        assert bool(rig.bodies.lin_vel.any()) == pushes


def test_anchors_beside_the_centre_of_mass_turn_the_vehicle() -> None:
    """The cable keeps its length, momentum stays, a pull at +x along -z pitches down, and the errors of angular momentum and
    length are of first order in dt at the least."""
    errors = []
    for dt in (2e-3, 1e-3):
        rig = Rig(16, 3, dt=dt, anchor=(0.05, 0.0, -0.02))
        rig.bodies.com[:] = torch.tensor([0.0, 0.01, 0.005])
        tumble(rig)
        before = rig.sums()
        rig.fly(round(0.2 / dt))
        after = rig.sums()
        torch.testing.assert_close(after[0], before[0], rtol=0.0, atol=2e-5)
        torch.testing.assert_close(rig.lengths(), torch.full((16, 3), 0.8), rtol=0.0, atol=1e-4)
        errors.append(float((after[1] - before[1]).norm(dim=-1).mean()))
    assert log2(errors[0] / errors[1]) > 0.8
    rig = Rig(1, 1, anchor=(0.05, 0.0, 0.0), angle=0.0)
    rig.bodies.com[:] = torch.tensor([0.0, 0.0, 0.05])
    rig.payload.lin_vel[0, 2] = -1.0
    before = rig.com_and_velocity()[0]
    rig.fly(1)
    place, velocity = rig.com_and_velocity()
    torch.testing.assert_close(
        place - before, rig.dt * velocity, rtol=1e-3, atol=0.0
    )  # along -z, as semi-implicit Euler
    assert rig.bodies.ang_vel[0, 1] > 0.0  # x cross -z = +y
    assert rig.bodies.lin_vel[0, 2] < 0.0


@pytest.mark.parametrize("cables", ["rigid", "slack"])
def test_an_environment_is_the_same_alone_and_among_others(cables: str) -> None:
    many, alone = Rig(3, 3, cables=cables), Rig(1, 3, cables=cables)
    tumble(many)
    for name, tensor in vars(alone.bodies).items():
        tensor.copy_(getattr(many.bodies, name)[6:])
    alone.payload.position.copy_(many.payload.position[2:])
    alone.payload.lin_vel.copy_(many.payload.lin_vel[2:])
    for rig in (many, alone):
        rig.fly(100)
    assert torch.equal(many.payload.position[2:], alone.payload.position)
    assert torch.equal(many.payload.tension[2:], alone.payload.tension)
    assert torch.equal(many.bodies.position[6:], alone.bodies.position)
