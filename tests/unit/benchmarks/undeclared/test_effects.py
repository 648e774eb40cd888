"""The truth plant: loads on cables and soft arms, gusts, sensors, unknown forces and drawn parameters.
``tests/cross/test_truth_plant.py`` compares its accelerations with those of the package."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from benchmarks.undeclared import EFFECTS, FEATURES, UNKNOWN, make_case
from benchmarks.undeclared.cases import fly_case, list_flights, plan_flights
from benchmarks.undeclared.dynamics import POS, RATE, ROTOR, VEL, Plant, rest_state, rotation_matrices
from benchmarks.undeclared.effects import SIZES, effect_parameters, flight_features, split_vehicles
from benchmarks.undeclared.full_dynamics import CABLE, CABLE_RATE, FullPlant, make_plant
from benchmarks.undeclared.logs import vehicle_document
from benchmarks.undeclared.sensors import NO_BIAS, NOISELESS, PlantSensors
from benchmarks.undeclared.simulate import CONTROL_RATE, SUBSTEPS, summarise
from benchmarks.undeclared.surroundings import (
    FULL_VOLTAGE,
    RESISTANCE,
    VOLTAGE_PER_CHARGE,
    Battery,
    PlantSurroundings,
    companion_path,
    gust_series,
)
from benchmarks.undeclared.vehicle import DECLARED, GRAVITY, NEUTRAL, ROTOR_RADIUS, Array, Extra, PlantVehicle

BARE = replace(DECLARED, linear_drag=np.zeros(3), inertia=np.diag([2e-3, 3e-3, 4e-3]))
HOVER = DECLARED.hover_speed()
WEIGHT = 0.75 * GRAVITY
SPEED = 1000.0  # Of all rotors in the closed forms below [rad/s]


def set_extra(vehicle: PlantVehicle = BARE, **extra: object) -> PlantVehicle:
    return replace(vehicle, extra=replace(NEUTRAL, **extra))


def hide_effects(vehicle: PlantVehicle = BARE, **effects: dict[str, float]) -> PlantVehicle:
    return split_vehicles(vehicle, effect_parameters(effects, declared=vehicle, seed=0))[1]


def level(*, height: float = 5.0, rotor: float = SPEED, flights: int = 1) -> Array:
    state = rest_state(DECLARED, np.tile([0.0, 0.0, height], (flights, 1)), np.zeros(flights))
    state[:, ROTOR] = rotor
    return state


def loads(plant: Plant, state: Array) -> tuple[Array, Array]:
    """Return force and angular momentum rate about the centre of mass, body frame, (3,) each, from the accelerations."""
    slope = plant.derivative(state, state[:, ROTOR])
    vehicle, rate = plant.vehicle, state[0, RATE]
    force = vehicle.mass * (slope[0, VEL] + (0.0, 0.0, GRAVITY)) @ rotation_matrices(state)[0]
    return force, vehicle.inertia @ slope[0, RATE] + np.cross(rate, vehicle.inertia @ rate)


def effect_force(vehicle: PlantVehicle, state: Array, surroundings: PlantSurroundings | None = None) -> tuple:
    """Return the difference of force and moment between a vehicle and the same one without hidden effects."""
    full, bare = loads(FullPlant(vehicle, surroundings), state), loads(Plant(replace(vehicle, extra=NEUTRAL)), state)
    return full[0] - bare[0], full[1] - bare[1]


def tumble_state() -> Array:
    state = level(height=0.4)
    state[:, VEL], state[:, RATE], state[:, ROTOR] = (2.0, -1.0, 0.5), (3.0, -4.0, 2.0), (900.0, 1200.0, 1300.0, 1000.0)
    return state


def full_plant() -> FullPlant:
    extra = Extra(
        h_force=5e-5, flapping=3e-7, axial_inflow=8e-5, translational_lift=0.01, rotor_inertia=2e-5, slung=(0.1, 0.7, 0.03),
        shear=(3.0, -1.0, 10.0, 0.3), ground=2.0, periodic=(0.3, 7.0), attraction=(0.5, 0.5, 1.0, 0.5, 1.0),
        fading=(0.2, 0.1), shadow=(0.3, 0.5),
    )  # fmt: skip
    return FullPlant(replace(DECLARED, com=np.array([0.03, -0.05, 0.04]), extra=extra))


def test_neutral_extras_change_nothing() -> None:
    """The full plant without extras has the derivative of the plain one, to round-off, and is not used for it."""
    state, command = tumble_state(), np.full((1, 4), 1100.0)
    expected = Plant(DECLARED).derivative(state, command)
    np.testing.assert_allclose(FullPlant(DECLARED).derivative(state, command), expected, rtol=1e-12, atol=1e-12)
    assert type(make_plant(DECLARED, PlantSurroundings(ceiling=9.0))) is Plant


def test_values_of_the_first_effects_are_fixed() -> None:
    """What seed 3 draws; a new effect must not change the old ones, so it goes to the end of the table."""
    params = effect_parameters(dict.fromkeys(list(EFFECTS)[:6], "moderate"), declared=DECLARED, seed=3)
    first = [next(iter(values.values())) for values in params.values()]
    expected = [0.19169996034979464, 0.04752592812756322, 0.9512606322403725, -0.004233882317750705]
    expected += [0.06248253136610584, -2.1697157141040098]
    np.testing.assert_allclose(first, expected, rtol=1e-12)
    assert list(UNKNOWN) == ["unknown_periodic", "unknown_position", "unknown_time", "unknown_heading"]


def test_full_step_has_order_four() -> None:
    """The error falls with dt^4, within 0.15, with every smooth load at work and time in the equations."""
    start = full_plant().states_at_rest(tumble_state())
    start[:, CABLE_RATE] = (0.5, -0.3, 0.0)

    def end(steps: int) -> Array:
        plant, state, command = full_plant(), start, np.full((1, 4), 1600.0)
        for _ in range(steps):
            state = plant.step(state, command, 0.04 / steps)
        return state[0, : CABLE.start]

    fine = end(256)
    errors = [np.linalg.norm(end(n) - fine) for n in (8, 16, 32)]
    np.testing.assert_allclose(np.diff(np.log2(errors)), -4.0, atol=0.15)


@pytest.mark.parametrize("delay", [0.0025, pytest.param(0.008, marks=pytest.mark.slow)])
def test_rotors_follow_the_command_of_that_long_ago(delay: float) -> None:
    """Exponential towards the command that was sent ``delay`` ago, also within a sample; Runge-Kutta to (h / tau)^4."""
    effects = {"actuation_delay": {"delay": delay}}
    case = fly_case(effects=effects, seed=4, num_train=1, num_test=0, duration_s=1.0, noise=NOISELESS)
    rotor, command = case.record.measured["rotor"][:, 0], case.record.command[:, 0]
    h, late = 1.0 / CONTROL_RATE / SUBSTEPS, delay * CONTROL_RATE
    for k in range(10, len(rotor) - 1, 7):
        speed = rotor[k]
        for j in range(SUBSTEPS):
            sent = command[int(np.floor(k + j / SUBSTEPS - late + 1e-9))]
            speed = sent + (speed - sent) * np.exp(-h / 0.038)
        np.testing.assert_allclose(rotor[k + 1], speed, rtol=1e-8)
    assert np.ptp(command, axis=0).min() > 1.0  # a command that moves


def test_rotor_speed_follows_the_voltage() -> None:
    """Steady speed n = cmd (1 + gain (V / 16 - 1)): at 14.4 V and gain 0.5, 5 % less."""
    plant = FullPlant(hide_effects(battery_sag={"gain": 0.5}))
    plant.begin_sample(0, np.array([14.4, 16.0]))
    state = level(flights=2)
    state[:, ROTOR] = np.array([[950.0], [1000.0]])
    np.testing.assert_allclose(plant.derivative(state, np.full((2, 4), 1000.0))[:, ROTOR], 0.0, atol=1e-9)


def test_battery_gives_the_power_and_loses_the_charge() -> None:
    """V I = P and V = V0 - R I with P the power of the drag torque over the efficiency; dV0 = -slope I dt."""
    battery, rotor = Battery(DECLARED, np.array([0.0, 900.0])), np.array([[1126.0] * 4, [1500.0] * 4])
    power = 4 * 0.014 * 1.45e-6 * np.array([1126.0, 1500.0]) ** 3 / 0.6
    opened = FULL_VOLTAGE - VOLTAGE_PER_CHARGE * np.array([0.0, 900.0])
    for _ in range(3):
        voltage = battery.discharge(rotor, 10.0)
        current = power / voltage
        np.testing.assert_allclose(voltage, opened - RESISTANCE * current, rtol=1e-12)
        opened = opened - VOLTAGE_PER_CHARGE * current * 10.0
    assert voltage[0] > voltage[1]


def test_slung_load_swings_at_the_frequency_of_the_pair() -> None:
    """w = sqrt(g / l (1 + M / m)): back after a period and opposite after half of it, to the square of the angle."""
    mass, length, angle = 0.15, 0.8, 0.01
    plant = FullPlant(set_extra(slung=(mass, length, 0.0)))
    speed = np.sqrt((0.75 + mass) * GRAVITY / 4 / 1.45e-6)
    state = plant.states_at_rest(level(rotor=speed))
    state[0, CABLE] = (np.sin(angle), 0.0, -np.cos(angle))
    half = np.pi / np.sqrt(GRAVITY / length * (1.0 + mass / 0.75))
    for sign in (-1.0, 1.0):
        for _ in range(500):
            state = plant.step(state, np.full((1, 4), speed), half / 500)
        np.testing.assert_allclose(state[0, CABLE], (sign * np.sin(angle), 0.0, -np.cos(angle)), atol=angle**2)


def test_slung_load_keeps_momentum_and_damping_takes_energy() -> None:
    """Free fall of a turning pair: m v + M (v + l q') = -(m + M) g t; swing energy kept without damping, lost with it.
    In the falling frame the energy is ``m M / (m + M) l² |q'|² / 2``, and damping c takes it at the rate ``2 c (1 / m +
    1 / M)``."""
    mass, length, span = 0.15, 0.8, 0.5
    for damping in (0.0, 0.05):
        plant = FullPlant(set_extra(slung=(mass, length, damping)))
        state = plant.states_at_rest(level(rotor=0.0))
        state[0, CABLE_RATE] = (2.0, 1.0, 0.0)
        before = (0.75 + mass) * state[0, VEL] + mass * length * state[0, CABLE_RATE]
        for _ in range(500):
            state = plant.step(state, np.zeros((1, 4)), span / 500)
        after = (0.75 + mass) * state[0, VEL] + mass * length * state[0, CABLE_RATE]
        np.testing.assert_allclose(after - before, (0.0, 0.0, -(0.75 + mass) * GRAVITY * span), atol=1e-8)
        share = np.exp(-2.0 * damping * (1.0 / 0.75 + 1.0 / mass) * span)
        assert np.sum(state[0, CABLE_RATE] ** 2) == pytest.approx(5.0 * share, rel=1e-7)
        assert np.linalg.norm(state[0, CABLE]) == pytest.approx(1.0, abs=1e-12)


SOFT = {"compliance": 1.5, "tau": 0.05, "hinge": 0.4}


def test_elements_of_an_arm_approach_their_load_and_add_up() -> None:
    """From straight, under held thrust: ``C f l (1 - exp(-t / tau))`` each, and the wrench is that of the sum of angles."""
    slow = {**SOFT, "tau": 2.0}
    plant = FullPlant(hide_effects(joint_spring=SOFT, joint_creep=slow))
    state = np.hstack((level(), np.zeros((1, 8))))
    for _ in range(200):
        state = plant.step(state, state[:, ROTOR], 0.0005)
    full = 1.5 * 1.45 * 0.6 * np.hypot(0.085, 0.08)
    np.testing.assert_allclose(state[0, 22:26], full * (1.0 - np.exp(-0.1 / 0.05)), rtol=1e-9)
    np.testing.assert_allclose(state[0, 26:30], full * (1.0 - np.exp(-0.1 / 2.0)), rtol=1e-9)
    both = state[0, 22] + state[0, 26]
    assert loads(plant, state)[0][2] == pytest.approx(4.0 * 1.45 * np.cos(both), rel=1e-12)


def test_a_second_joint_further_out_bends_the_rest_of_the_arm() -> None:
    """The moment about the inner joint is that of the shorter lever ``a + b cos h2`` once the outer one has turned by h2."""
    inner, outer = {**SOFT, "hinge": 0.2}, {**SOFT, "hinge": 0.7}
    plant = FullPlant(hide_effects(joint_spring=outer, joint_creep=inner))
    state = np.hstack((level(), np.zeros((1, 8))))
    state[0, 22:26] = 0.4  # of the outer joint
    reach = np.hypot(0.085, 0.08)
    slope = plant.derivative(state, state[:, ROTOR])[0, 22:]
    lever = reach * (0.5 * np.cos(0.4) + 0.3)  # of a thrust that stands upright on the last piece
    np.testing.assert_allclose(slope[4:], 1.5 * 1.45 * lever / 0.05, rtol=1e-12)
    np.testing.assert_allclose(slope[:4], (1.5 * 1.45 * 0.3 * reach - 0.4) / 0.05, rtol=1e-12)


def test_soft_arms_and_a_load_share_the_state() -> None:
    plant = FullPlant(hide_effects(joint_spring=SOFT, slung_payload={"mass": 0.1, "length": 0.7, "damping": 0.02}))
    state = plant.states_at_rest(level(flights=2))
    assert state.shape == (2, 32)
    np.testing.assert_allclose(state[:, CABLE], [[0.0, 0.0, -1.0]] * 2)
    np.testing.assert_allclose(plant.step(state, state[:, ROTOR], 0.0005)[:, 28:], state[:, 28:], rtol=1e-12)


def test_gusts_have_their_spread_and_memory() -> None:
    """Variance and correlation exp(-t / T) of 1000 correlation times, three axes, within five standard errors."""
    series = gust_series(1.5, 0.5, 200_000, 400.0, np.random.default_rng(0))
    error = np.sqrt(2.0 / 3000.0)
    assert series.var() == pytest.approx(2.25, rel=5.0 * error)
    for lag, expected in ((200, np.exp(-1.0)), (100, np.exp(-0.5)), (1200, np.exp(-6.0))):
        result = (series[lag:] * series[:-lag]).mean() / series.var()
        assert result == pytest.approx(expected, abs=5.0 * error)
    assert abs(series.mean()) < 5.0 * 1.5 * error


def test_gusts_push_through_drag() -> None:
    """A gust of 2 m/s along world x on a vehicle at rest: force d 2 along x; the next sample has its own."""
    series = np.array([[[2.0, 0.0, 0.0]], [[0.0, -1.0, 0.0]]])
    plant = FullPlant(replace(BARE, linear_drag=np.full(3, 0.2)), PlantSurroundings(gust=series))
    still = loads(Plant(BARE), level())[0]
    np.testing.assert_allclose(loads(plant, level())[0] - still, (0.4, 0.0, 0.0), atol=1e-12)
    plant.begin_sample(1, np.array([16.0]))
    np.testing.assert_allclose(loads(plant, level())[0] - still, (0.0, -0.2, 0.0), atol=1e-12)


def test_another_vehicle_stays_higher() -> None:
    case_flights = flight_features(["downwash"], ())
    assert case_flights == ("battery", "other")
    reference = plan_flights(list_flights(2, 0), seed=3, duration_s=3.0)
    for flight in (0, 1):
        path = companion_path(reference, flight, CONTROL_RATE, np.random.default_rng(1))
        assert np.all(path[:, 2] > reference.position[:, flight, 2] + 0.9)
    assert np.ptp(path[:, :2], axis=0).max() == 0.0  # the second one hovers


def _read(vehicle: PlantVehicle, state: Array) -> object:
    sensors = PlantSensors(NOISELESS, NO_BIAS, [np.random.default_rng(0)], 1, extra=vehicle.extra)
    return sensors.sample(0, make_plant(vehicle), state)


def test_turned_imu_sees_gravity_from_the_other_side() -> None:
    """Hover, IMU rolled by +a: acc = g (0, sin a, cos a); pitched: g (-sin a, 0, cos a); yawed, a roll rate p reads
    p (cos a, -sin a, 0). Attitude is not of the IMU and stays."""
    state, a = level(rotor=HOVER), 0.1
    rolled = _read(hide_effects(imu_misalignment={"roll": a}), state)
    np.testing.assert_allclose(rolled.acc[0], GRAVITY * np.array([0.0, np.sin(a), np.cos(a)]), atol=1e-12)
    pitched = _read(hide_effects(imu_misalignment={"pitch": a}), state)
    np.testing.assert_allclose(pitched.acc[0], GRAVITY * np.array([-np.sin(a), 0.0, np.cos(a)]), atol=1e-12)
    state[:, RATE] = (2.0, 0.0, 0.0)
    yawed = _read(hide_effects(imu_misalignment={"yaw": a}), state)
    np.testing.assert_allclose(yawed.rate[0], 2.0 * np.array([np.cos(a), -np.sin(a), 0.0]), atol=1e-12)
    np.testing.assert_array_equal(yawed.rotation, rotation_matrices(state))


def test_biases_and_rotor_scale_are_in_the_readings_only() -> None:
    bias = {"ax": 0.1, "ay": -0.2, "az": 0.3, "gx": 0.01, "gy": -0.02, "gz": 0.03}
    read = _read(hide_effects(imu_bias=bias, rotor_speed_scale={"scale": 1.05}), level(rotor=HOVER))
    np.testing.assert_allclose(read.acc[0], (0.1, -0.2, GRAVITY + 0.3), atol=1e-12)
    np.testing.assert_allclose(read.rate[0], (0.01, -0.02, 0.03), atol=1e-15)
    np.testing.assert_allclose(read.rotor[0], 1.05 * HOVER, rtol=1e-12)


def test_unknown_periodic_force() -> None:
    """F sin(2 pi f t) along body x: after half a period v = F / (m pi f), after a whole one none."""
    plant, state = FullPlant(hide_effects(unknown_periodic={"force": 0.3, "freq": 7.0})), level(rotor=0.0)
    half = 0.5 / 7.0
    for expected in (0.3 / (0.75 * np.pi * 7.0), 0.0):
        for _ in range(50):
            state = plant.step(state, np.zeros((1, 4)), half / 50)
        np.testing.assert_allclose(state[0, 3:5], (expected, 0.0), atol=1e-7)


def test_unknown_attraction_is_largest_at_its_radius_and_has_a_potential() -> None:
    """Force F towards the centre at one radius; |v|² / 2 m - F r exp((1 - d²) / 2) + m g z is constant."""
    vehicle = hide_effects(unknown_position={"x": 1.0, "z": 5.0, "force": 0.4, "radius": 1.0})
    np.testing.assert_allclose(effect_force(vehicle, level())[0], (0.4, 0.0, 0.0), atol=1e-12)
    plant, state = FullPlant(vehicle), level(rotor=0.0)

    def energy(state: Array) -> float:
        apart = state[0, POS] - (1.0, 0.0, 5.0)
        kinetic = 0.375 * state[0, VEL] @ state[0, VEL]
        return float(kinetic - 0.4 * np.exp(0.5 - 0.5 * apart @ apart) + WEIGHT * state[0, 2])

    start = energy(state)
    for _ in range(200):
        state = plant.step(state, np.zeros((1, 4)), 0.005)
    assert energy(state) == pytest.approx(start, abs=1e-7)


def test_unknown_fading_and_heading() -> None:
    """Thrust loses (1 - 1/e) of the loss in one time constant; the side force is largest at its heading, none opposite."""
    plant, state = FullPlant(hide_effects(unknown_time={"loss": 0.2, "time": 8.0})), level(rotor=HOVER)
    plant.begin_sample(round(8.0 * CONTROL_RATE), np.array([16.0]))
    assert loads(plant, state)[0][2] / WEIGHT == pytest.approx(1.0 - 0.2 * (1.0 - np.exp(-1.0)))
    vehicle = hide_effects(unknown_heading={"force": 0.3, "heading": 0.5})
    for yaw, force in ((0.5, 0.3), (0.5 + np.pi / 3, 0.15), (0.5 + np.pi, 0.0)):
        state = rest_state(BARE, np.zeros((1, 3)), np.array([yaw]))
        np.testing.assert_allclose(effect_force(vehicle, state)[0], (0.0, force, 0.0), atol=1e-12)


@pytest.mark.parametrize("name", [*list(EFFECTS)[6:], *UNKNOWN])
def test_draws_are_what_their_parameters_say(name: str) -> None:
    """Every size of every seed has all parameters, gives a valid vehicle, and differs from the declared one."""
    effect = {**EFFECTS, **UNKNOWN}[name]
    assert set(effect.needs) <= set(FEATURES)
    for size in SIZES:
        for seed in range(20):
            params = effect_parameters({name: size}, declared=DECLARED, seed=seed)
            assert set(params[name]) == set(effect.params)
            vehicle = split_vehicles(DECLARED, params)[1]
            assert vehicle_document(vehicle) != vehicle_document(DECLARED)
            moments = np.linalg.eigvalsh(vehicle.inertia)
            assert moments[2] < moments[0] + moments[1]  # of a body
    values = [effect_parameters({name: "moderate"}, declared=DECLARED, seed=seed)[name] for seed in range(4)]
    assert any(value != values[0] for value in values)


MILD = ("h_force_flapping", "axial_inflow", "translational_lift", "gusts")
DRIVES = ("battery_sag", "actuation_delay", "rotor_inertia", "motor_tilt", "weak_motor")
LOADS = ("slung_payload", "inertia_error", "torque_ratio", "wind_shear")
NEAR = ("ground_effect", "ceiling_effect", "downwash", "payload_mass")
READINGS = ("imu_bias", "imu_misalignment", "rotor_speed_scale", "motor_asymmetry")
BODY = ("joint_spring", "joint_creep", "com_offset", "thrust_coefficient")


@pytest.mark.usefixtures("coarser_plant")
@pytest.mark.parametrize("effects", [MILD, DRIVES, LOADS, NEAR, READINGS, BODY, tuple(UNKNOWN)])
@pytest.mark.slow
def test_flights_follow_their_reference_with_several_effects(effects: tuple[str, ...]) -> None:
    """The autopilot holds on to its reference within 0.25 m with four or more moderate effects at once. The delay among
    them is rounded to the coarser steps: 0.3 mm."""
    case = fly_case(effects=dict.fromkeys(effects, "moderate"), seed=5, num_train=2, num_test=0, duration_s=1.5)
    first = round(2.0 * CONTROL_RATE)
    for flight in summarise(case.record, case.reference, declared=case.declared, first=first):
        assert flight.rms_position_error < 0.25
        assert flight.top_tilt < np.deg2rad(60.0)
        assert flight.saturated_share < 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("coarser_plant")
def test_flights_have_the_features_they_need(tmp_path: Path) -> None:
    short = {"seed": 2, "num_train": 4, "num_test": 0, "duration_s": 1.0}
    files = make_case(tmp_path / "all", effects={}, features=FEATURES, **short)
    tables = [np.genfromtxt(path, delimiter=",", names=True) for path in files.train]
    assert tables[0].dtype.names[-5:] == ("vbat", "other_p_x", "other_p_y", "other_p_z", "ceiling_z")
    heights = [table["p_z"] for table in tables]
    assert 0.05 < heights[2].min() < 0.6
    assert 13.3 < heights[3].max() < 13.95
    for table in tables:
        assert np.all(table["other_p_z"] > table["p_z"])
        assert np.ptp(table["vbat"]) > 0.05
    assert yaml.safe_load(files.robot.read_text())["rotor"]["radius"] == ROTOR_RADIUS
    plain = make_case(tmp_path / "plain", effects={"rotor_drag": "small"}, **{**short, "num_train": 1})
    assert np.genfromtxt(plain.train[0], delimiter=",", names=True)["vbat"].std() == 0.0
    assert "radius" not in yaml.safe_load(plain.robot.read_text())["rotor"]
    assert "features" not in plain.truth.read_text()


def test_shear_flights_have_heights_that_differ() -> None:
    heights = [f.lowest for f in list_flights(4, 3, flight_features(["wind_shear"], ()))]
    assert max(heights[:4]) / min(heights[:4]) > 10.0
    assert max(heights[4:]) / min(heights[4:]) > 10.0


@pytest.mark.parametrize(("effects", "features", "message"), [
    ({"rotor_dragg": "small"}, (), "no effect 'rotor_dragg'. Known: rotor_drag"),
    ({"com_offset": "huge"}, (), "com_offset: no size 'huge'"),
    ({"com_offset": {"w": 1.0}}, (), r"com_offset: no parameter \['w'\]"),
    ({"thrust_coefficient": {}}, (), "thrust_coefficient.scale = None: must be given"),
    ({"weak_motor": {"motor": 5, "scale": 0.9}}, (), "motor = 5.0: must be a whole number from 1 to 4"),
    ({"actuation_delay": {"delay": 0.0101}}, (), "delay = 0.0101: must be a multiple of 0.0005 s"),
    ({}, ("lowest",), r"no feature \['lowest'\]. Known: battery"),
])  # fmt: skip
def test_wrong_requests_are_refused(effects: dict, features: tuple[str, ...], message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=message):
        make_case(tmp_path, effects=effects, seed=0, features=features)


@pytest.mark.parametrize(("name", "needs"), [("ceiling_effect", "a ceiling"), ("downwash", "another vehicle")])
def test_effects_need_their_surroundings(name: str, needs: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: needs {needs}"):
        FullPlant(hide_effects(**{name: "large"}))


@pytest.mark.usefixtures("coarser_plant")
def test_a_flight_into_the_ground_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="train_1: came within"):
        make_case(tmp_path, effects={"payload_mass": {"dm": 3.0}}, seed=0, num_train=1, num_test=0, duration_s=1.0)
