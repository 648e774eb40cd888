"""Inertia of thrown bodies against motions that Euler's equations give, which the fit itself does not use."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.teststand import inertia_study
from aerial_gym.sim2real.teststand.inertia_study import ThrowSeries, study_inertia
from aerial_gym.sim2real.teststand.report import Study
from aerial_gym.sim2real.teststand.throws import (
    FreeFlight,
    find_free_flight,
    fit_momentum,
    matrix_of_elements,
    steiner_term,
)

WHEEL = 1.7e-6  # Inertia of the flywheel [kg m²]
AXIS = np.array([0.02, -0.01, -1.0]) / np.linalg.norm([0.02, -0.01, -1.0])
RATE = 2000.0
DEVICE = np.diag((9.0e-5, 7.5e-5, 2.5e-5))
DEVICE_MASS, BODY_MASS = 0.1, 0.3
LEVER = np.array((0.004, -0.003, 0.03))
"""Position of the device's centre of mass from that of the body [m]."""
IMU = np.array((-0.002, 0.011, -0.009))
"""Position of the IMU from the device's centre of mass [m]."""
TURN = np.linalg.qr(np.array(((1.0, 0.3, 0.1), (-0.2, 1.0, 0.2), (0.1, -0.1, 1.0))))[0]
BODY = np.asarray(TURN @ np.diag((5.0e-4, 1.1e-3, 1.4e-3)) @ TURN.T, dtype=np.float64)


def wheel_speed(time: Array, begin: float = 0.25) -> Array:
    rise, fall = np.minimum(np.maximum(time - begin, 0.0), 0.55 - begin), np.maximum(time - 0.55, 0.0)
    return 1300.0 * (1.0 - np.exp(-rise / 0.05)) * np.exp(-fall / 0.05)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors; ``np.cross`` takes 50 times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def throw(
    inertia: Array, imu: Array, start: Array, *, drag: float = 0.0, late: float = 0.0, seed: int = 0,
    rate: float = RATE, begin: float = 0.25, hit: float = np.inf, end: float = np.inf,
) -> FreeFlight:  # fmt: skip
    """Return a record: 0.2 s in the hand, then free flight by Euler's equations. The wheel begins to turn at ``begin`` [s],
    something hits the body at ``hit`` [s], and ``end`` is the end of the gyro's range [rad/s]."""
    time, inverse = np.arange(0.0, 0.75, 1.0 / rate), np.linalg.inv(inertia)

    def acceleration(now: float, rates: Array) -> Array:
        step = 1e-5
        speed, after = wheel_speed(np.array((now, now + step)), begin)
        momentum = inertia @ rates + WHEEL * speed * AXIS
        torque = -cross(rates, momentum) - WHEEL * (after - speed) / step * AXIS - drag * np.linalg.norm(rates) * rates
        return inverse @ (torque + (abs(now - hit) < 0.005) * np.array((0.02, -0.015, 0.01)))

    solution = solve_ivp(acceleration, (0.0, 0.75), start, t_eval=time, rtol=1e-9, atol=1e-9, max_step=2e-3)
    rates = solution.y.T
    change = np.array([acceleration(now, row) for now, row in zip(time, rates, strict=True)])
    force = np.cross(change, imu) + np.cross(rates, np.cross(rates, imu))
    force[time < 0.2] += (0.0, 0.0, -25.0)
    force[np.abs(time - hit) < 0.005] += (60.0, -80.0, 100.0)
    rng = np.random.default_rng(seed)
    return FreeFlight(
        name="throw", time=time, ang_vel=np.clip(rates + rng.normal(0.0, 0.005, rates.shape), -end, end),
        specific_force=force + rng.normal(0.0, 0.3, force.shape), wheel_speed=wheel_speed(time - late, begin),
    )  # fmt: skip


STARTS = ((9.0, -5.0, 3.0), (-4.0, 8.0, 6.0), (6.0, 6.0, -7.0), (-7.0, -3.0, 8.0))


def throws(inertia: Array, imu: Array, **options: float) -> list[FreeFlight]:
    return [throw(inertia, imu, np.array(start), seed=n, **options) for n, start in enumerate(STARTS)]  # type: ignore[arg-type]


def joint_throws(body: Array) -> list[FreeFlight]:
    """Return throws of a body and the device together, which turn about their common centre of mass."""
    share = DEVICE_MASS / (DEVICE_MASS + BODY_MASS)
    apart = steiner_term(DEVICE_MASS, LEVER * (1.0 - share)) + steiner_term(BODY_MASS, LEVER * share)
    return throws(body + DEVICE + apart, IMU + LEVER * (1.0 - share))


def test_momentum_gives_inertia_axis_and_position() -> None:
    flights = [find_free_flight(flight) for flight in throws(BODY, IMU, drag=3e-5, late=0.002)]
    wheel, (fit,) = fit_momentum([flights])
    np.testing.assert_allclose(WHEEL * fit.inertia, BODY, atol=0.004 * BODY.max())
    np.testing.assert_allclose(fit.imu_position, IMU, atol=3e-4)
    np.testing.assert_allclose(wheel.axis, AXIS, atol=0.004)
    assert wheel.lateness == pytest.approx(0.002, abs=2e-4)
    assert all(flight.time[0] >= 0.2 for flight in flights)


def test_one_throw_is_inside_its_interval() -> None:
    _, (fit,) = fit_momentum([[find_free_flight(throw(BODY, IMU, np.array(STARTS[0])))]])
    values = np.array([fit.inertia[k, k] for k in range(3)])
    deviation = np.sqrt(np.diag(fit.covariance)[:3])
    assert (np.abs(values - np.diag(BODY) / WHEEL) < 4.0 * deviation + 0.005 * values).all()
    assert (deviation < 0.05 * values).all()


@pytest.mark.parametrize(
    "options",
    [
        {"rate": 250.0, "drag": 3e-6, "late": 0.002},
        {"rate": 4000.0},
        {
            "rate": 500.0,
            "drag": 1e-4,
        },  # takes half of the momentum, and turns the first estimate of the axis by 50 degrees
        {"rate": 500.0, "begin": 0.05},  # the wheel turns in the hand already
        {"rate": 500.0, "hit": 0.35},
    ],
)
def test_moments_and_axes_of_one_and_of_four_throws(options: dict[str, float]) -> None:
    """One throw gives each moment within 5 % or its interval, four within 1.5 %, and axes within 3 degrees."""
    flights = [find_free_flight(flight) for flight in throws(BODY, IMU, **options)]
    truth, axes = np.linalg.eigh(BODY)
    for group, most in ((flights, 0.015), *(([flight], 0.05) for flight in flights)):
        _, (fit,) = fit_momentum([group])
        moments, directions = np.linalg.eigh(WHEEL * fit.inertia)
        deviation = WHEEL * np.sqrt(np.diag(fit.covariance)[:3]).max()
        assert (np.abs(moments / truth - 1.0) < np.maximum(most, 4.0 * deviation / truth)).all()
        turns = np.degrees(np.arccos(np.clip(np.abs((directions * axes).sum(axis=0)), 0.0, 1.0)))
        assert turns.max() < 3.0 or deviation > 0.05 * truth[0]
    assert all(
        0.2 < flight.time[0] < flight.time[-1] < options.get("hit", 1.0) or flight.time[0] > 0.35 for flight in flights
    )


def test_parts_between_saturation_of_the_gyro_give_the_inertia() -> None:
    """Beyond 2000 deg/s the gyro shows its end, several times in a throw: one throw is too little, three are enough."""
    end, sizes = np.radians(2000.0), (3.3, 4.0, 4.0, 3.6)
    starts = [size * np.array(start) for size, start in zip(sizes, STARTS, strict=True)]
    records = [throw(BODY, IMU, start, seed=n, end=end) for n, start in enumerate(starts) if n != 2]
    flights = [find_free_flight(record) for record in records]
    assert all(np.abs(record.ang_vel).max() == end for record in records)
    assert all(len(flight.spans) > 1 for flight in flights)
    _, (fit,) = fit_momentum([flights])
    np.testing.assert_allclose(WHEEL * fit.inertia, BODY, atol=0.01 * BODY.max())
    with pytest.raises(DataError, match="unknowns"):
        fit_momentum([flights[1:2]])
    with pytest.raises(DataError, match="less spin"):
        find_free_flight(throw(BODY, IMU, 5.0 * np.array(STARTS[0]), end=end))


def paths_of_throws(groups: dict[str, list[FreeFlight]], monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Return names that the study reads as the throws of each group."""
    flights = {f"{name}{n}": find_free_flight(f) for name, group in groups.items() for n, f in enumerate(group)}
    monkeypatch.setattr(inertia_study, "read_throw", lambda path: flights[str(path)])
    return {name: [f"{name}{n}" for n in range(len(group))] for name, group in groups.items()}


def test_device_and_proof_body_give_the_body_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The proof body is the body itself turned by 0: its known inertia calibrates the wheel."""
    paths = paths_of_throws({"body": joint_throws(BODY), "device": throws(DEVICE, IMU)}, monkeypatch)
    study = study_inertia(
        ThrowSeries(paths=paths["body"], mass=BODY_MASS),  # type: ignore[arg-type]
        ThrowSeries(paths=paths["device"], mass=DEVICE_MASS),  # type: ignore[arg-type]
        None,
        WHEEL,
    )
    np.testing.assert_allclose(study.mapping["inertia_kg_m2"], BODY, atol=0.01 * BODY.max())  # type: ignore[arg-type]
    np.testing.assert_allclose(study.mapping["centre_of_mass_m"], -(IMU + LEVER), atol=5e-4)  # type: ignore[arg-type]


def test_intervals_of_axes_cover_the_turns_that_noise_causes() -> None:
    """Against eigenvectors of matrices with random elements: 95 % of the turns lie inside; equal moments leave them open."""
    rng = np.random.default_rng(0)
    root = 1e-5 * rng.normal(size=(6, 6)) / np.sqrt(6.0)
    moments, axes = np.linalg.eigh(BODY)
    widths = inertia_study.half_widths_of_axis_angles(moments, axes, root @ root.T)
    inside = []
    for _ in range(400):
        noise = matrix_of_elements(root @ rng.normal(size=6))
        turned = np.linalg.eigh(BODY + noise)[1]
        inside.append(np.abs(turned[:, 1] @ axes[:, 2]) < np.sin(widths[1, 2]))
    assert 0.93 < np.mean(inside) <= 1.0
    equal = inertia_study.half_widths_of_axis_angles(np.array((5e-4, 1.4e-3, 1.4e-3)), axes, root @ root.T)
    assert equal[1, 2] == pytest.approx(np.pi / 4)
    assert equal[0, 1] < 0.1


def test_proof_body_gives_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    moments = (5.0e-4, 1.1e-3, 1.4e-3)
    paths = paths_of_throws({"device": throws(DEVICE, IMU), "proof": joint_throws(np.diag(moments))}, monkeypatch)
    study = study_inertia(
        ThrowSeries(paths=paths["proof"], mass=BODY_MASS),  # type: ignore[arg-type]
        ThrowSeries(paths=paths["device"], mass=DEVICE_MASS),  # type: ignore[arg-type]
        ThrowSeries(paths=paths["proof"], mass=BODY_MASS, inertia=moments),  # type: ignore[arg-type]
        None,
    )
    wheel = study.mapping["wheel_inertia_kg_m2"]
    assert wheel["value"] == pytest.approx(WHEEL, rel=0.01)  # type: ignore[index]


def test_refusals() -> None:
    still = throw(BODY, IMU, np.array(STARTS[0]))
    with pytest.raises(DataError):
        find_free_flight(FreeFlight(
            name="still", time=still.time, ang_vel=still.ang_vel, specific_force=still.specific_force,
            wheel_speed=np.zeros_like(still.time),
        ))  # fmt: skip
    body = ThrowSeries(paths=[], mass=0.3)
    for device, proof, wheel in (
        (None, None, None),
        (None, body, None),
        (ThrowSeries(paths=[]), None, 1e-6),
        (body, body, 1e-6),
    ):
        with pytest.raises(ConfigError):
            study_inertia(body, device, proof, wheel)


def test_a_flight_is_no_throw() -> None:
    """Rotors that carry a vehicle give it a specific force of 9.8 m/s², which no spin explains."""
    flight = throw(BODY, IMU, 0.1 * np.array(STARTS[0]))
    carried = flight.specific_force + np.array((0.0, 0.0, 9.8))
    with pytest.raises(DataError, match="no throw"):
        find_free_flight(replace(flight, specific_force=carried))


def make_study(monkeypatch: pytest.MonkeyPatch, flights: list[FreeFlight], mass: float, wheel: float) -> Study:
    parts = {str(n): find_free_flight(flight) for n, flight in enumerate(flights)}
    monkeypatch.setattr(inertia_study, "read_throw", lambda path: parts[str(path)])
    return study_inertia(ThrowSeries(paths=list(map(Path, parts)), mass=mass), None, None, wheel)


def test_throws_of_two_bodies_or_without_spin_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    both = [throw(inertia, IMU, np.array(start)) for inertia, start in zip((BODY, DEVICE), STARTS, strict=False)]
    with pytest.raises(DataError, match="same body"):
        make_study(monkeypatch, both, BODY_MASS, WHEEL)
    with pytest.raises(DataError):
        make_study(monkeypatch, [throw(BODY, IMU, np.array((0.0, 0.0, 1e-3)))], BODY_MASS, WHEEL)


@pytest.mark.parametrize(("mass", "wheel"), [(-0.3, WHEEL), (0.3, -WHEEL), (float("nan"), WHEEL), (0.3, 0.0)])
def test_wrong_masses_and_wheels_are_refused(monkeypatch: pytest.MonkeyPatch, mass: float, wheel: float) -> None:
    with pytest.raises(ConfigError):
        make_study(monkeypatch, [], mass, wheel)
