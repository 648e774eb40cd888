"""Robot files of a 3-inch quadrotor, against least squares of the same flights that share no code with the product.

Each flight begins with a throw, in which the firmware turns up one rotor after the other. There no controller answers the air,
so plain least squares are free of its bias. The change of the gyro over ``SPAN_S`` is compared with the integral of squared
speeds, the change of the speeds and the integral of the gyroscopic products. Nothing is filtered. Axes: forward, left, up.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.robots.drafts.draft import robot_yaml_with_origins
from aerial_gym.sim2real import replay
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.log_readers import read_raw_log
from aerial_gym.sim2real.teststand.vehicle_draft import LogDraft
from aerial_gym.sim2real.teststand.vehicle_from_log import draft_vehicle

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "real_logs"
LOGS = sorted((FOLDER / "betaflight").glob("indiflight_*"))
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not LOGS, reason="needs the logs of INDIFLIGHT")]

SPAN_S, MASS, ARM = 0.03, 0.428, 0.07
SIGNS = np.array(((-1, -1, 1, 1), (1, -1, 1, -1), (1, -1, -1, 1)))  # Rear right, front right, rear left, front left
ALONE = (1500.0, 900.0)  # Speeds of a rotor that is turned up alone, and of the others [rad/s]


def columns(path: Path) -> tuple[Array, Array, Array, Array]:
    """Return time [s], angular velocity [rad/s], rotor speeds [rad/s] and commands."""
    topic = read_raw_log(path).topics[0]  # type: ignore[union-attr]
    rates = topic.numbers(*(f"gyroADCafterRpm[{i}]" for i in range(3)), unit=np.pi / 1800.0)
    speeds, motors = (topic.numbers(*(f"{name}[{i}]" for i in range(4))) for name in ("omegaUnfiltered", "motor"))
    return topic.time, rates, speeds, (motors - 158.0) / 1889.0


def equations(path: Path) -> tuple[Array, Array]:
    """Return the terms and the changes of the gyro in the time in which single rotors turn up; no rows without such a time."""
    time, rates, speeds, _ = columns(path)
    alone = (speeds.max(axis=1) > ALONE[0]) & (np.sort(speeds, axis=1)[:, 2] < ALONE[1])
    rows = np.flatnonzero(alone)
    if rows.size < 20:
        return np.empty((0, 8)), np.empty((0, 3))
    part = (time > time[rows[0]] - 0.06) & (time < time[rows[-1]] + 0.1)
    time, rates, speeds = time[part], rates[part], speeds[part]
    products = np.stack((rates[:, 1] * rates[:, 2], rates[:, 2] * rates[:, 0], rates[:, 0] * rates[:, 1]), axis=1)
    integrand = np.concatenate((speeds**2, products), axis=1)
    steps = 0.5 * (integrand[1:] + integrand[:-1]) * np.diff(time)[:, None]
    integral = np.concatenate((np.zeros((1, 7)), np.cumsum(steps, axis=0)))
    terms = np.concatenate((integral, (speeds @ SIGNS[2])[:, None]), axis=1)
    shift = round(SPAN_S / float(np.median(np.diff(time))))
    return terms[shift:] - terms[:-shift], rates[shift:] - rates[:-shift]


def effectiveness(paths: list[Path]) -> Array:
    """Return the angular acceleration of each rotor per squared speed about each axis, (3, 4)."""
    terms, changes = (np.concatenate(parts) for parts in zip(*map(equations, paths), strict=True))
    size = np.sqrt((terms**2).mean(axis=0))
    fit = np.linalg.lstsq(terms / size, changes, rcond=None)[0] / size[:, None]
    return fit[:4].T


def steady_speeds(paths: list[Path]) -> Array:
    """Return medians of command and speed where the command has hardly changed for 120 ms, in bands of 0.1, (bands, 2)."""
    pairs = []
    for path in paths:
        time, _, speeds, given = columns(path)
        shift = round(0.12 / float(np.median(np.diff(time))))
        spread = np.max([np.abs(given[shift:] - given[k : k - shift]) for k in range(0, shift, 4)], axis=0)
        calm = (spread < 0.03) & (speeds[shift:] > 400.0)
        pairs.append(np.stack((given[shift:][calm], speeds[shift:][calm]), axis=1))
    table = np.concatenate(pairs)
    bands = [table[np.floor(10.0 * table[:, 0]) == band] for band in range(10)]
    return np.array([np.median(band, axis=0) for band in bands if len(band) > 50])


def errors(draft: LogDraft, paths: list[Path]) -> dict[str, tuple[float, bool]]:
    """Return relative differences to the independent fit of what a flight shows, and whether the number is called assumed."""
    rotors = effectiveness(paths)
    np.testing.assert_array_equal(np.sign(rotors), SIGNS)
    truth = np.abs((rotors * SIGNS).mean(axis=1))
    return {
        name: (draft.values[name].value / value - 1.0, draft.values[name].is_assumed)
        for name, value in zip(("roll", "pitch", "yaw"), truth, strict=True)
        if name in draft.values
    }


@pytest.mark.parametrize(
    "paths",
    [LOGS, *([path] for path in LOGS)],
    ids=lambda paths: "_".join([str(len(paths)), *(path.stem for path in paths[-1:])]),
)
def test_drafts_agree_with_an_independent_fit(paths: list[Path]) -> None:
    draft = draft_vehicle(paths, mass=MASS, arm=ARM)
    np.testing.assert_array_equal(np.sign(draft.places[:, :2].T), np.stack((-SIGNS[1], SIGNS[0])))
    np.testing.assert_array_equal(draft.spins, -SIGNS[2])
    compared = errors(draft, paths)
    print({name: f"{100 * error:+.0f} %{' assumed' * assumed}" for name, (error, assumed) in compared.items()})
    assert all(abs(error) < 0.15 or assumed for error, assumed in compared.values())
    assert draft.curve is not None
    command, speed = steady_speeds(paths).T
    difference = (draft.curve.offset.value + draft.curve.gain.value * command**draft.curve.power.value) / speed - 1.0
    print(f"steady speed at commands {np.round(command, 2)}: {np.round(100 * difference)} %")
    assert difference.size >= 3
    assert np.abs(difference).max() < 0.15


@pytest.mark.parametrize(
    ("log", "mass"),
    [
        *((str(path), MASS) for path in LOGS),
        (str(FOLDER / "betaflight" / "bf451_erpm_5inch.BFL"), 0.6),
        (f"{FOLDER / 'ardupilot' / 'copter364_two_flights.bin'}#1", 1.5),
        (f"{FOLDER / 'ardupilot' / 'copter364_two_flights.bin'}#2", 1.5),
        (str(FOLDER / "px4" / "quad_hover_second_output_instance.ulg"), 1.5),
    ],
    ids=lambda value: Path(str(value)).stem,
)
def test_replay_of_the_own_flight_is_inside_the_interval_of_the_thrust(log: str, mass: float, tmp_path: Path) -> None:
    """By the mean vertical force; in the second flight of ArduPilot the vehicle carries a load for ten seconds."""
    draft = draft_vehicle([log], mass=mass, arm=ARM)
    thrust = draft.values["hover_thrust" if draft.force_mode else "thrust"]
    (tmp_path / "v.yaml").write_text(robot_yaml_with_origins(draft, name="log"))
    (tmp_path / "v.mapping.yaml").write_text(draft.mapping)
    replay(str(tmp_path / "v.yaml"), [log], tmp_path / "out", mapping=str(tmp_path / "v.mapping.yaml"))
    rows = pd.read_csv(tmp_path / "out" / "residuals.csv")
    measured, error = rows["specific_force_z_measured"].mean(), rows["specific_force_z_before"].mean()
    print(f"{thrust.origin}; mean error {error:+.2f} m/s² of {measured:.2f}")
    if log.endswith("#2"):
        assert thrust.is_assumed
        return
    low, high = map(float, re.findall(r"[\d.e+-]+", thrust.origin.split("[")[1])[:2])
    assert 0.995 * low < thrust.value * measured / (measured - error) < 1.005 * high  # printed with three digits
