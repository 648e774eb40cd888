"""The truth plant: other published laws, against closed forms and momentum balances that are solved here."""

import numpy as np
import pytest
from scipy.optimize import fsolve

from benchmarks.undeclared.dynamics import RATE, ROTOR, VEL, rest_state
from benchmarks.undeclared.effects import CAUSES, cause_names, split_vehicles
from benchmarks.undeclared.full_dynamics import CABLE, CABLE_RATE, FullPlant, near_surface
from benchmarks.undeclared.other_laws import OTHER_LAWS, downwash_force, drag_force, gust_series_by_law, thrust_ratio
from benchmarks.undeclared.vehicle import DECLARED, GRAVITY, ROTOR_RADIUS, Array

HEIGHTS = np.array([0.08, 0.15, 0.3])


def test_far_surfaces_change_nothing() -> None:
    for name, effect in OTHER_LAWS.items():
        if name.startswith(("ground", "ceiling")):
            values = effect.draw(np.random.default_rng(1), effect.ranges[1][1], DECLARED)
            extra = effect.apply(DECLARED, values).extra
            np.testing.assert_allclose(
                thrust_ratio(extra.ground_law or extra.ceiling_law, np.array([20.0])), 1.0, atol=1e-5
            )


def test_laws_of_surfaces_have_their_closed_forms() -> None:
    x = HEIGHTS / ROTOR_RADIUS
    np.testing.assert_allclose(thrust_ratio(("inverse_square", 0.15), HEIGHTS), 1.0 + 0.15 / x**2)
    np.testing.assert_allclose(thrust_ratio(("offset", 2.0, 0.0), HEIGHTS), near_surface(2.0, HEIGHTS))
    np.testing.assert_allclose(thrust_ratio(("exponential", 0.4, 0.8), HEIGHTS), 1.0 + 0.4 * np.exp(-0.8 * x))
    at_centre = thrust_ratio(("loss", 0.4, 0.8, 0.05, x[1]), HEIGHTS)[1]
    assert at_centre == pytest.approx(1.0 + 0.4 * np.exp(-0.8 * x[1]) - 0.05)
    np.testing.assert_allclose(thrust_ratio(("power", 2.0), HEIGHTS), (0.9926 + 0.03794 * 8.0 / x**2) ** (2 / 3))


def test_one_rotor_over_its_image_is_that_of_the_source() -> None:
    """Sources of strength A v / (4 pi) and their images: the upwash at each hub is the sum over images at ``r² + 4 z²``."""
    z, side = 2.5, 0.1625 / ROTOR_RADIUS

    def upwash(distance: float) -> float:
        apart = np.hypot(distance, 2.0 * z)
        return 0.25 * 2.0 * z / apart**3  # A / (4 pi) = R² / 4, the vertical part of a point source

    expected = upwash(0.0) + 2.0 * upwash(side) + upwash(2**0.5 * side)
    ratio = thrust_ratio(("images", 0.0), np.array([z * ROTOR_RADIUS]))[0]
    assert 1.0 - 1.0 / ratio == pytest.approx(expected, rel=1e-6)


def test_ceiling_momentum_balances() -> None:
    """T = v_far² / 2; T less the suction of the radial flow on the ceiling = v v_far; T = T_s - s v; rho A = 1."""
    x, slope = 1.2, 0.9
    free = 1.0  # inflow in the open, where T = 2 v²

    def defects(unknown: Array) -> list[float]:
        inflow, far, thrust = unknown
        suction = inflow**2 / (16.0 * x**2)
        blade = 2.0 * free**2 * (1.0 + slope) - slope * 2.0 * free * inflow
        return [thrust - 0.5 * far**2, thrust - suction - inflow * far, thrust - blade]

    thrust = fsolve(defects, [1.0, 2.0, 2.0])[2]
    ratio = thrust_ratio(("momentum", 1.0, slope), np.array([x * ROTOR_RADIUS]))[0]
    assert ratio == pytest.approx(thrust / 2.0, rel=1e-9)


@pytest.mark.parametrize(("law", "vertical", "correlation"), [
    (("weak_vertical", 1.2, 0.8, 0.4), 0.4, np.exp(-1.0)),
    (("dryden", 1.2, 3.0, 3.0 / 0.8), (0.177 + 0.0027) ** 0.4, 0.5 * np.exp(-1.0)),
])  # fmt: skip
def test_gusts_have_their_intensity_and_correlation(law: tuple, vertical: float, correlation: float) -> None:
    """A first-order filter has ``exp(-t / T)``, the vertical Dryden filter ``(1 - t / 2T) exp(-t / T)``; T = 0.8 s of z."""
    wind = gust_series_by_law(law, 400_000, 50.0, np.random.default_rng(2))
    spread = wind.std(axis=0)
    np.testing.assert_allclose(spread / 1.2, (1.0, 1.0, vertical), rtol=0.08)
    lag = 40
    z = wind[:, 2] / spread[2]
    assert (z[lag:] * z[:-lag]).mean() == pytest.approx(correlation, abs=0.03)


def test_downwash_and_drag_have_their_closed_forms() -> None:
    apart = np.array([[0.0, 0.0, 1.5], [0.3, 0.0, 1.5], [0.0, 0.0, 3.0], [0.0, 0.0, -1.5], [0.9, 0.0, 1.5]])
    jet = downwash_force(("jet", 0.5, 0.2), apart)
    np.testing.assert_allclose(jet[:4], 0.5 * np.array([1.0, np.exp(-1.0), 0.25, 0.0]))
    np.testing.assert_allclose(downwash_force(("top_hat", 0.5, 0.3), apart), [0.5, 0.25, 0.5, 0.0, 0.0], atol=1e-4)
    air = np.array([[2.0, -3.0, 1.0]])
    np.testing.assert_allclose(drag_force(("thrust", 0.2, 0.1, 0.0), air, np.array([3.0]), 6.0), [[-0.2, 0.15, 0.0]])
    np.testing.assert_allclose(drag_force(("plate", 0.1, 0.1, 0.1), air, air[:, 0], 6.0), [[-0.4, 0.9, -0.1]])


def hang_load(name: str, **params: float) -> tuple[FullPlant, Array]:
    """Return a plant with a load, and its state of level rest at the speed that carries vehicle and load."""
    plant = FullPlant(split_vehicles(DECLARED, {name: params})[1])
    state = plant.states_at_rest(rest_state(DECLARED, np.zeros((1, 3)), np.zeros(1)))
    state[:, ROTOR] = np.sqrt((DECLARED.mass + params["mass"]) * GRAVITY / (4.0 * DECLARED.thrust_coeff[0]))
    return plant, state


def test_elastic_cable_hangs_at_rest_and_keeps_momentum() -> None:
    """At rest nothing accelerates; stretched and aside, the sum of both bodies has the acceleration of thrust and weight."""
    plant, state = hang_load("slung_payload/elastic", mass=0.06, length=0.7, stretch=0.03, hook=0.05)
    slope = plant.derivative(state, state[:, ROTOR])
    for part in (VEL, RATE, CABLE_RATE):
        np.testing.assert_allclose(slope[0, part], 0.0, atol=1e-9)
    state[0, CABLE], state[0, CABLE_RATE] = (0.3, -0.2, -0.75), (0.1, 0.2, -0.3)
    slope = plant.derivative(state, state[:, ROTOR])
    load = slope[0, VEL] + slope[0, CABLE_RATE]
    np.testing.assert_allclose(0.75 * slope[0, VEL] + 0.06 * load, 0.0, atol=1e-9)
    pull = 0.06 * (load + np.array([0.0, 0.0, GRAVITY]))  # of the cable on the load, upwards
    moment = np.cross((0.0, 0.0, -0.05), -pull)
    np.testing.assert_allclose(DECLARED.inertia @ slope[0, RATE], moment, atol=1e-9)


def test_rod_swings_as_a_rigid_rod() -> None:
    """Small angle: ``(M L²/3 - (M L/2)² / (m + M)) a'' = -M g L/2 a``."""
    mass, length, angle = 0.06, 0.9, 1e-4
    plant, state = hang_load("slung_payload/rod", mass=mass, length=length, damping=0.0)
    state[0, CABLE] = (np.sin(angle), 0.0, -np.cos(angle))
    swing = plant.derivative(state, state[:, ROTOR])[0, CABLE_RATE][0]
    inertia = mass * length**2 / 3.0 - (0.5 * mass * length) ** 2 / (DECLARED.mass + mass)
    assert swing == pytest.approx(-0.5 * mass * GRAVITY * length * angle / inertia, rel=1e-6)


def test_causes_have_the_names_of_the_package() -> None:
    from aerial_gym.physics.effects import EFFECTS as LIBRARY

    names = {name: cause_names(name) for name in CAUSES if not name.startswith("unknown")}
    assert all(one in LIBRARY for group in names.values() for one in group)
    assert names["ground_effect/loss"] == ("ground_effect",)
