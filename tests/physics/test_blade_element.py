"""The blade-element rotor against integrals of its blade elements, its limits and tunnel tests. A rotor of radius 0.1 m
turns at 800 rad/s; ``rho pi R² (w R)²`` is the unit of its coefficients. All cases are one rotor on the vertical axis
of a body, unless something else is said, so that what the body feels is what the rotor does."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt

import numpy as np
import pytest
import torch
from scipy.optimize import brentq, minimize_scalar

from aerial_gym.config.robot import BodyCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.effects.blade_element import REFERENCE_SLOPE, _inflow, lift_slope, reynolds_number
from aerial_gym.physics.effects.induced_flow import (
    AIR_DENSITY,
    DESCENT_FIT,
    WINDMILL,
    axial_induced_velocity,
    induced_velocity,
)
from aerial_gym.physics.model import check_effects
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import F64, make_effects, random_state

RADIUS, SPEED = 0.1, 800.0
TIP = RADIUS * SPEED
UNIT = AIR_DENSITY * pi * (RADIUS * TIP) ** 2
LIFT, TWIST = 0.57, -0.25
THRUST, TORQUE = 0.013, 0.0021
"""Coefficients of the maps: the ideal torque is 0.00105."""

INFLOW = sqrt(0.5 * THRUST)
THETA = 2.0 * THRUST / LIFT + 0.5 * INFLOW
ROOT = 3.0 * (THETA - 0.25 * TWIST)
PROFILE = TORQUE - INFLOW * THRUST
VALUES = {"share": 1.0, "solidity": 0.1, "lift_slope": 5.7, "twist": TWIST, "lock": 0.7, "flap_frequency": 900.0}


def one_rotor(*, spin: int = 1, reversible: bool = False, thrust: float = THRUST, torque: float = TORQUE) -> RobotCfg:
    square = UNIT / SPEED**2
    return RobotCfg(
        summary="one rotor",
        body=BodyCfg(mass=0.3, inertia=((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3)), source="test"),
        rotor=RotorCfg(
            thrust_map=(0.0, 0.0, thrust * square), torque_map=(0.0, 0.0, torque * square * RADIUS),
            time_constant_up=0.03, time_constant_down=0.03, thrust_range=(-20.0 if reversible else 0.0, 20.0),
            radius=RADIUS, source="test",
        ),
        mounts=MountsCfg(layout=(MountCfg(position=(0.0, 0.0, 0.0), spin=spin),), source="test"),
        collision=ROBOTS.get("tinyprop").collision,
    )  # fmt: skip


def loads(
    velocity: list[float], *, speed: float = SPEED, spin: int = 1, reversible: bool = False, thrust: float = THRUST,
    **changes: float,
) -> np.ndarray:  # fmt: skip
    """Return force and torque on the body, (6,), in units of the rotor, its own among them; ``velocity`` per tip speed."""
    robot = one_rotor(spin=spin, reversible=reversible, thrust=thrust, torque=TORQUE * (thrust / THRUST) ** 1.5)
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model = build_model(vehicle, make_effects({"blade_element": VALUES | changes}, 1))
    state = random_state(1)
    for rows, row in (
        (state.position, [0.0, 0.0, 5.0]),
        (state.attitude, [0.0, 0.0, 0.0, 1.0]),
        (state.lin_vel, [TIP * v for v in velocity]),
        (state.ang_vel, [0.0, 0.0, 0.0]),
    ):
        rows[:] = torch.tensor(row, dtype=F64)
    state = replace(state, rotor_speed=torch.full((1, 1), speed, dtype=F64))
    felt = accelerations(model, state)
    force, torque = felt.specific_force[0] * 0.3, felt.ang_acc[0] * 1e-3
    return torch.cat((force / UNIT, torque / (UNIT * RADIUS))).numpy()


def solve_inflow(thrust: float, mu: float) -> float:
    """Return the inflow at which blades of these numbers give a thrust: their own equation, turned about."""
    lifted = THETA + mu**2 * (0.5 * ROOT + 0.25 * TWIST)
    return 2.0 * (lifted - 2.0 * thrust / LIFT)


def test_at_rest_in_still_air_it_is_the_declared_rotor() -> None:
    np.testing.assert_allclose(loads([0.0, 0.0, 0.0]), [0, 0, THRUST, 0, 0, -TORQUE], atol=1e-12)


@pytest.mark.parametrize("climb", [0.01, 0.05, 0.1])
def test_a_climb_is_that_of_blade_element_momentum_theory(climb: float) -> None:
    """``lambda² + (s a / 8 - climb) lambda - s a Theta / 4 = 0``, the root of ``2 (lambda - climb) lambda = C_T``."""
    linear = LIFT / 8.0 - climb
    inflow = 0.5 * (-linear + sqrt(linear**2 + LIFT * THETA))
    thrust = 0.5 * LIFT * (THETA - 0.5 * inflow)
    assert 2.0 * (inflow - climb) * inflow == pytest.approx(thrust, rel=1e-12)
    assert thrust < THRUST
    expected = [0.0, 0.0, thrust, 0.0, 0.0, -(inflow * thrust + PROFILE)]
    np.testing.assert_allclose(loads([0.0, 0.0, climb]), expected, atol=1e-11)


@pytest.mark.parametrize("descent", [0.35, 0.4, 0.6])
def test_a_windmill_is_that_of_momentum_theory(descent: float) -> None:
    """``C_T = -2 lambda (lambda + descent)`` with the air going up through the disc; the air drives the rotor."""
    result = loads([0.0, 0.0, -descent])
    inflow = solve_inflow(result[2], 0.0)
    assert -descent < inflow < -0.5 * descent
    # the search ends within 1e-4 of the inflow of hover, of which blades make s a / 4 in thrust
    assert result[2] == pytest.approx(-2.0 * inflow * (inflow + descent), abs=0.25 * LIFT * 1e-4 * INFLOW)
    assert result[5] == pytest.approx(-(inflow * result[2] + PROFILE), abs=1e-9)
    assert result[5] > 0.0  # the air turns the rotor


@pytest.mark.parametrize("ratio", [-0.3, -0.9, -1.5, -1.9])
def test_in_the_vortex_ring_the_inflow_is_the_measured_one(ratio: float) -> None:
    k1, k2, k3, k4 = DESCENT_FIT
    whole = ratio + 1.0 + k1 * ratio + k2 * ratio**2 + k3 * ratio**3 + k4 * ratio**4
    linear = 0.25 * LIFT * whole
    hover = 0.25 * (-linear + sqrt(linear**2 + 4.0 * LIFT * THETA))
    result = loads([0.0, 0.0, ratio * hover])
    assert result[2] == pytest.approx(2.0 * hover**2, rel=1e-4)


@pytest.mark.parametrize(("lift", "thrust"), [(0.2, 0.03), (0.57, 0.013), (1.2, 0.005)])
def test_the_search_for_the_inflow_ends_at_the_root(lift: float, thrust: float) -> None:
    """Against 80 halvings, over climbs and descents of half the tip speed and sideways speeds up to it."""
    climb, mu = (
        grid.flatten()
        for grid in torch.meshgrid(torch.linspace(-0.5, 0.5, 301), torch.linspace(0.0, 1.0, 21), indexing="ij")
    )
    climb, mu, hover = climb.to(F64), mu.to(F64), sqrt(0.5 * thrust)
    lifted = (2.0 * thrust / lift + 0.5 * hover) * (1.0 + 1.5 * mu.square())
    low, high = torch.zeros_like(mu), torch.ones_like(mu)
    for _ in range(80):
        middle = 0.5 * (low + high)
        value = induced_velocity(middle.clamp_min(1e-9), climb, mu)[0]
        above = 2.0 * middle.square() >= 0.5 * lift * (lifted - 0.5 * (climb + value))
        low, high = torch.where(above, low, middle), torch.where(above, middle, high)
    exact = induced_velocity(high.clamp_min(1e-9), climb, mu)[0]
    assert ((_inflow(torch.tensor(lift, dtype=F64), lifted, climb, mu) - exact).abs() < 1e-4 * hover).all()


def test_induced_velocities_join_without_a_jump() -> None:
    at = torch.tensor([WINDMILL - 1e-9, WINDMILL + 1e-9, -1e-9, 1e-9, 3.0, -6.0], dtype=F64)
    value, _ = axial_induced_velocity(at)
    assert abs(value[0] - value[1]) < 1e-6
    torch.testing.assert_close(value[2:4], torch.ones(2, dtype=F64), atol=1e-8, rtol=0.0)
    assert value[4] == pytest.approx(-1.5 + sqrt(1.5**2 + 1.0))
    assert value[5] == pytest.approx(3.0 - sqrt(8.0))


def test_slopes_of_the_induced_velocity_are_its_differences() -> None:
    x = torch.cat((torch.linspace(-4.0, -2.05, 9), torch.linspace(-2.0, -0.1, 9), torch.linspace(0.1, 3.0, 9))).to(F64)
    step = 1e-6
    slope = (axial_induced_velocity(x + step)[0] - axial_induced_velocity(x - step)[0]) / (2.0 * step)
    torch.testing.assert_close(axial_induced_velocity(x)[1], slope, atol=1e-7, rtol=1e-7)
    hover, edge = torch.full_like(x, 0.8), torch.full_like(x, 0.7)
    slope = (induced_velocity(hover + step, 0.8 * x, edge)[0] - induced_velocity(hover - step, 0.8 * x, edge)[0]) / (
        2.0 * step
    )
    torch.testing.assert_close(induced_velocity(hover, 0.8 * x, edge)[1], slope, atol=1e-7, rtol=1e-7)


def test_sideways_flow_is_glauerts() -> None:
    """``f² (y² + f²) = 1`` at x = 0, and f near 1 / y at high speed; in climb within 10 % of momentum theory."""
    y = torch.linspace(0.0, 8.0, 33, dtype=F64)
    one, zero = torch.ones_like(y), torch.zeros_like(y)
    f = induced_velocity(one, zero, y)[0]
    torch.testing.assert_close(f.square() * (y.square() + f.square()), one)
    assert f[-1] * y[-1] == pytest.approx(1.0, abs=1e-3)
    for x in (0.5, 1.0, 2.0):
        f = induced_velocity(one, x * one, y)[0]
        exact = f.clone()
        for _ in range(200):
            exact = 0.5 * (exact + 1.0 / (y.square() + (x + exact).square()).sqrt())
        assert ((f / exact - 1.0).abs() < 0.1).all()


def integrate_blade(inflow: float, mu: float, *, lock: float, stiffness: float, harmonics: int) -> np.ndarray:
    """Return thrust, force against the motion and to the side of 90 degrees azimuth, torque, and the means of spring
    moments. Integrals of blade elements over radius (Gauss) and azimuth. Flapping, ``b'' + (1 + k) b = lock / 2 M``, is
    linear in b: it is solved at 32 azimuths for some harmonics (Galerkin), and for coning where these are more than one. The
    profile drag is that of the torque map; ``stiffness`` is k."""
    count = 32
    azimuth = 2.0 * pi * np.arange(count) / count
    nodes, weights = np.polynomial.legendre.leggauss(8)
    r, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    wave = np.fft.fftfreq(count, 1.0 / count)[:, None] * 1j
    wave[count // 2] = 0.0
    slope, bend = (np.real(np.fft.ifft(power * np.fft.fft(np.eye(count), axis=0), axis=0)) for power in (wave, wave**2))
    sine, cosine = np.sin(azimuth)[:, None], np.cos(azimuth)[:, None]
    across, pitch = r + mu * sine, ROOT + TWIST * r
    steady = ((pitch * across**2 - inflow * across) * r) @ weights
    by_rate, by_angle = (across * r**2) @ weights, (mu * cosine * across * r) @ weights
    matrix = bend + (1.0 + stiffness) * np.eye(count) + 0.5 * lock * (by_rate[:, None] * slope + np.diag(by_angle))
    orders = np.arange(1, harmonics + 1)
    basis = np.hstack((np.cos(orders * azimuth[:, None]), np.sin(orders * azimuth[:, None])))
    if harmonics > 1:
        basis = np.hstack((np.ones_like(sine), basis))
    flap = basis @ np.linalg.solve(basis.T @ matrix @ basis, basis.T @ (0.5 * lock * steady))
    through = inflow + r * (slope @ flap)[:, None] + mu * flap[:, None] * cosine
    lift = pitch * across**2 - through * across
    drag = (pitch * across - through) * through + 8.0 * PROFILE / LIFT * across**2
    loads = (
        lift, drag * sine - lift * flap[:, None] * cosine, -drag * cosine - lift * flap[:, None] * sine, drag * r,
        2.0 * stiffness / lock * flap[:, None] * cosine, 2.0 * stiffness / lock * flap[:, None] * sine,
    )  # fmt: skip
    return 0.5 * LIFT * np.array([float(((load + 0.0 * r) @ weights).mean()) for load in loads])


@pytest.mark.parametrize("lock", [0.7, 4.0])
@pytest.mark.parametrize("flap", [0.0, 900.0, 9e4])
@pytest.mark.parametrize(("mu", "climb"), [(0.05, 0.0), (0.15, 0.0), (0.3, 0.0), (0.1, 0.05), (0.1, -0.02)])
def test_forces_are_those_of_an_integration_over_radius_and_azimuth(
    mu: float, climb: float, flap: float, lock: float
) -> None:
    """At the inflow that gives the thrust, which in level flight is Glauert's. Flapping of one harmonic: exact. Coning and
    the other harmonics, which are left out, change no force of blades with the Lock number of a plastic propeller by more
    than 0.5 % of the thrust."""
    result = loads([mu, 0.0, climb], flap_frequency=flap, lock=lock)
    for harmonics in (1, 12) if lock < 1.0 else (1,):
        at = {"mu": mu, "lock": lock, "stiffness": (flap / SPEED) ** 2, "harmonics": harmonics}

        def thrust_error(inflow: float, at: dict[str, float] = at) -> float:
            return integrate_blade(inflow, **at)[0] - result[2]

        inflow = brentq(thrust_error, -0.2, 0.4, xtol=1e-14)
        thrust, back, side, torque, spring_back, spring_side = integrate_blade(inflow, **at)
        if climb == 0.0 and harmonics == 1:
            assert 2.0 * inflow * sqrt(mu**2 + inflow**2) == pytest.approx(thrust, rel=1e-3)
        expected = np.array([-back, -side, thrust, -spring_side, spring_back, -torque])
        rtol, atol = (1e-7, 1e-9) if harmonics == 1 else (1e-3, 0.005 * thrust)
        np.testing.assert_allclose(result, expected, rtol=rtol, atol=atol)


def test_a_share_of_the_model_is_that_share_of_its_loads() -> None:
    whole, none, part = (loads([0.1, 0.05, 0.03], share=share) for share in (1.0, 0.0, 0.3))
    np.testing.assert_allclose(none, [0.0, 0.0, THRUST, 0.0, 0.0, -TORQUE], atol=1e-12)
    np.testing.assert_allclose(part, none + 0.3 * (whole - none), rtol=1e-12, atol=1e-15)


def test_beyond_the_tip_speed_loads_stay_those_at_it() -> None:
    for fast, limit in (([1.5, 0.0, 0.0], [1.0, 0.0, 0.0]), ([0.0, 0.0, 1.3], [0.0, 0.0, 1.0])):
        np.testing.assert_allclose(loads(fast), loads(limit), atol=1e-9)
    np.testing.assert_allclose(loads([0.0, 0.0, -1.3]), loads([0.0, 0.0, -1.0]), atol=1e-9)
    for velocity in ([0.95, 0.0, 0.0], [0.0, 0.0, 0.95], [0.0, 0.0, -0.95]):
        assert np.abs(loads(velocity) - loads([v / 0.95 for v in velocity])).max() > 1e-3


def test_a_hinged_rotor_leans_back_and_a_stiff_one_rolls() -> None:
    """Forwards, counter-clockwise from above: the right side advances. Hinged: more H-force and no moment. Stiff: the lift of
    the right side turns the body to the left, negatively about x, by ``s a / 2 m_s mu``."""
    mu = 0.1
    hinged, stiff = (loads([mu, 0.0, 0.0], flap_frequency=flap) for flap in (0.0, 1e5))
    inflow = solve_inflow(hinged[2], mu)
    uneven = THETA - 0.25 * inflow
    blades = 0.25 * LIFT * inflow * (ROOT + 0.5 * TWIST) + 2.0 * PROFILE
    assert hinged[0] < -mu * (blades + 5.0 * uneven * hinged[2])
    np.testing.assert_allclose(hinged[3:5], 0.0, atol=1e-12)
    # k / g = (1e5 / 800)² / 0.0875 = 1.8e5
    np.testing.assert_allclose(stiff[:2], [-mu * blades, 0.0], atol=1e-7)
    np.testing.assert_allclose(stiff[3:5], [-0.5 * LIFT * uneven * mu, 0.0], atol=1e-7)
    between = loads([mu, 0.0, 0.0])
    assert between[1] > 0.0  # between the two the right side is up as well, and thrust leans to the left
    assert between[3] < 0.0
    assert between[4] < 0.0  # the nose goes up


@dataclass(frozen=True)
class Propeller:
    diameter: float  # [m]
    blades: int
    solidity: float  # Of the chord at 3/4 of the radius: blades times c / (pi R)
    rpm: float  # Of the tunnel test
    static: float  # Thrust coefficient at rest, mean over the speeds of the static test
    static_at_rpm: float  # Thrust coefficient at rest at the speed of the tunnel test, interpolated
    tunnel: tuple[tuple[float, float], ...]  # Advance ratio and thrust coefficient

    def errors(self, reference: float, *, static: float | None = None) -> np.ndarray:
        """Return the errors of the loss of thrust [% of static thrust] with a lift slope at the reference Reynolds number."""
        radius = 0.5 * self.diameter
        reynolds = reynolds_number(self.rpm * pi / 30.0, radius, self.solidity * pi * radius / self.blades)
        slope, static = lift_slope(reynolds) * reference / REFERENCE_SLOPE, static or self.static
        thrust = static * 4.0 / pi**3  # in the unit of the rotor
        result = [
            loads([0.0, 0.0, ratio / pi], thrust=thrust, solidity=self.solidity, lift_slope=slope)[2] / thrust
            for ratio, _ in self.tunnel
        ]
        return 100.0 * (np.array([c for _, c in self.tunnel]) / static - np.array(result))


APC, MICRO_INVENT, DA4052 = PROPELLERS = (
    Propeller(0.254, 2, 0.125, 6513.0, 0.1185, 0.1299, ((0.378, 0.0698), (0.599, 0.0176))),  # APC Slow Flyer 10x4.7
    Propeller(0.127, 3, 0.160, 6057.0, 0.1799, 0.1815, ((0.094, 0.182), (0.564, 0.0799))),  # Micro Invent 5x4
    Propeller(0.127, 3, 0.175, 7044.0, 0.1483, 0.1500, ((0.163, 0.139), (0.571, 0.0476))),  # DA4052 5x3.75
)
"""Source: UIUC propeller database, volumes 1 and 2 (Brandt, Deters, Ananda, Selig): geometry, static and tunnel tests."""


def fit_reference(propellers: Sequence[Propeller], statics: Sequence[float]) -> float:
    """Return the lift slope at the reference Reynolds number that fits the losses of some propellers best."""

    def misfit(slope: float) -> float:
        pairs = zip(propellers, statics, strict=True)
        return float(sum((one.errors(slope, static=static) ** 2).sum() for one, static in pairs))

    return minimize_scalar(misfit, bounds=(1.5, 6.5), method="bounded", options={"xatol": 0.01}).x


@pytest.mark.parametrize(
    ("kind", "third", "limit"),
    [
        ("static", MICRO_INVENT, 10.0), ("static", DA4052, 10.0), ("static", APC, 10.0),
        ("static_at_rpm", MICRO_INVENT, 10.0), ("static_at_rpm", DA4052, 10.0), ("static_at_rpm", APC, 13.0),
    ],
)  # fmt: skip
def test_a_lift_slope_of_two_propellers_predicts_the_climb_of_a_third(
    kind: str, third: Propeller, limit: float
) -> None:
    """One number is fitted, the lift slope at one Reynolds number. Beside mean static thrust all are within 10 points."""
    remaining = [one for one in PROPELLERS if one is not third]
    slope = fit_reference(remaining, [getattr(one, kind) for one in remaining])
    assert 3.2 < slope < 4.0
    assert np.abs(third.errors(slope, static=getattr(third, kind))).max() < limit


def test_the_reference_slope_is_the_fit_of_all_three() -> None:
    assert fit_reference(PROPELLERS, [one.static for one in PROPELLERS]) == pytest.approx(REFERENCE_SLOPE, abs=0.05)
    assert max(np.abs(one.errors(REFERENCE_SLOPE)).max() for one in PROPELLERS) < 10.0


def test_the_exponent_of_the_lift_slope_is_that_of_static_thrust() -> None:
    """With blades that turn twice as fast the static coefficient grows by ``2^0.09``, as that of 136 propellers."""

    def static_thrust(reynolds: float) -> float:
        lift = 0.1 * lift_slope(reynolds)
        inflow = brentq(lambda x: 2.0 * x * x - 0.5 * lift * (0.119 - 0.5 * x), 0.0, 1.0)  # Theta of C_T = 0.013
        return 2.0 * inflow * inflow

    assert static_thrust(5e4) == pytest.approx(0.013, rel=0.01)
    assert np.log2(static_thrust(1e5) / static_thrust(5e4)) == pytest.approx(0.09, abs=0.005)


@pytest.mark.parametrize("rotors", [1, 4])
def test_the_default_lift_slope_is_that_of_the_reynolds_number_at_hover(rotors: int) -> None:
    """0.1 of solidity with two blades: a chord of 15.7 mm at 0.1 m; thrust and speed at hover by the quadratic map."""
    robot = one_rotor()
    robot = replace(robot, mounts=replace(robot.mounts, layout=robot.mounts.layout * rotors))
    speed = sqrt(0.3 * STANDARD_GRAVITY / rotors / robot.the_rotor("the test").thrust_map[2])
    reynolds = 0.075 * speed * 0.05 * pi * RADIUS / 1.461e-5
    default = EFFECTS.get("blade_element").neutral(robot)[2]
    assert default == pytest.approx(3.3 * (reynolds / 5e4) ** 0.11, rel=1e-6)
    bare = replace(robot, rotor=replace(robot.the_rotor("the test"), radius=None))
    assert EFFECTS.get("blade_element").neutral(bare)[2] == 3.3


def test_the_mirror_image_flies_the_mirror_image() -> None:
    """The other sense of turning and the other sideways velocity: y-force, roll and yaw change sign, nothing else does."""
    a = loads([0.12, 0.07, -0.02])
    b = loads([0.12, -0.07, -0.02], spin=-1)
    np.testing.assert_allclose(b, a * np.array([1, -1, 1, -1, 1, -1]), atol=1e-15)


def test_a_reversed_rotor_is_one_upside_down() -> None:
    """Turned over about x, with y and z of the velocity the other way, and the same sense of turning about its own thrust."""
    a = loads([0.12, 0.07, -0.02], reversible=True)
    b = loads([0.12, -0.07, 0.02], speed=-SPEED, reversible=True)
    np.testing.assert_allclose(b, a * np.array([1, -1, -1, 1, -1, -1]), atol=1e-15)


def test_hubs_away_from_the_centre_turn_the_body() -> None:
    """With four rotors the torque beside hub moments is ``sum l x F``: here from thrusts that a roll rate makes uneven."""
    robot = ROBOTS.get("racing_quadrotor")
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=F64)
    model, bare = (build_model(vehicle, make_effects(e, 1)) for e in ({"blade_element": VALUES}, {}))
    state = random_state(1)
    state.lin_vel.zero_()
    state.attitude[:] = torch.tensor([0.0, 0.0, 0.0, 1.0], dtype=F64)
    state.ang_vel[:] = torch.tensor([3.0, 0.0, 0.0], dtype=F64)
    state.rotor_speed[:] = 1500.0
    more = accelerations(model, state).ang_acc - accelerations(bare, state).ang_acc
    assert more[0, 0] < 0.0  # against the roll


def test_what_no_propeller_can_do_is_refused() -> None:
    effects = {"effects": {"blade_element": VALUES}}
    check_effects(replace(one_rotor(), **effects))
    with pytest.raises(ConfigError, match="has a drag torque of at least"):
        check_effects(replace(one_rotor(torque=0.0009), **effects))
    robot = one_rotor()
    with pytest.raises(ConfigError, match=r"must give rotor.radius \[m\]"):
        check_effects(replace(robot, rotor=replace(robot.rotor, radius=None), **effects))


def test_neither_is_looked_for_unless_asked() -> None:
    assert not any(EFFECTS.get(name).by_default for name in ("blade_element", "vortex_ring"))
