"""Robot files from flights whose vehicle is known: accelerations by a table of effectiveness, which the fit does not see."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.cli.main import main
from aerial_gym.errors import DataError
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.teststand import vehicle_from_log
from aerial_gym.sim2real.teststand.log_geometry import BETAFLIGHT_X, RotorLayout, _px4_layout
from aerial_gym.sim2real.teststand.vehicle_from_log import draft_vehicle

RATE, SECONDS, MASS = 400.0, 16.0, 0.5
SIGNS = np.array(((-1, -1, 1, 1), (1, -1, 1, -1), (1, -1, -1, 1)))  # Roll, pitch, yaw, of Betaflight's order
SIZES = np.array((2.3e-5, 1.6e-5, 3.0e-6))  # Angular acceleration per squared speed
LIFT, LAG, IDLE, GAIN, POWER = 6.2e-7, 0.02, 450.0, 3600.0, 0.7


def write_flight(path: Path, seed: int, *, speeds: bool = True) -> Path:
    """Write a flight with slow random commands about hover; the vehicle's motion follows by sums over rotors."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, SECONDS, 1.0 / RATE)
    tones, phases = rng.uniform(0.3, 8.0, (6, 1, 4)), rng.uniform(0.0, 2 * np.pi, (6, 1, 4))
    command = 0.35 + 0.03 * np.sin(2 * np.pi * tones * time[:, None] + phases).sum(axis=0)
    steady = IDLE + GAIN * command**POWER
    speed = steady.copy()
    for k in range(1, time.size):
        speed[k] = steady[k - 1] + (speed[k - 1] - steady[k - 1]) * np.exp(-1.0 / (RATE * LAG))
    speed *= 1.0 + 1e-3 * rng.normal(size=speed.shape)
    acceleration = (speed**2) @ (SIGNS * SIZES[:, None]).T
    acceleration -= acceleration.mean(axis=0)
    rates = np.cumsum(acceleration, axis=0) / RATE + 0.01 * rng.normal(size=(time.size, 3))
    force = np.zeros((time.size, 3))
    force[:, 2] = LIFT * (speed**2).sum(axis=1)
    columns = {"t": time, "q_x": 0.0, "q_y": 0.0, "q_z": 0.0, "q_w": 1.0}
    columns |= {f"omega_{axis}": rates[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"acc_{axis}": force[:, k] + 0.2 * rng.normal(size=time.size) for k, axis in enumerate("xyz")}
    columns |= {f"rotor_{k + 1}": speed[:, k] for k in range(4)} if speeds else {}
    columns |= {f"cmd_{k + 1}": command[:, k] for k in range(4)}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("flights")
    return [write_flight(folder / f"flight_{seed}.csv", seed) for seed in range(2)]


def test_a_flight_gives_signs_sizes_curve_and_lag(flights: list[Path]) -> None:
    draft = draft_vehicle(flights, mass=MASS, arm=0.1)
    assert draft.effectiveness is not None
    assert draft.curve is not None
    np.testing.assert_array_equal(draft.effectiveness.signs, SIGNS)
    for size, truth in zip(draft.effectiveness.sizes, (*SIZES, LIFT), strict=True):
        assert size.value == pytest.approx(truth, rel=0.05)
    assert draft.spins == BETAFLIGHT_X[1]
    np.testing.assert_array_equal(np.sign(draft.places[:, :2]), np.sign(BETAFLIGHT_X[0]))
    assert draft.values["thrust"].value == pytest.approx(MASS * LIFT, rel=0.02)
    assert draft.curve.lag.value == pytest.approx(LAG, rel=0.1)
    half = IDLE + GAIN * 0.35**POWER
    curve = draft.curve
    assert curve.offset.value + curve.gain.value * 0.35**curve.power.value == pytest.approx(half, rel=0.01)
    side = 0.1 / np.sqrt(2.0)
    assert draft.values["inertia_x"].value == pytest.approx(side * MASS * LIFT / SIZES[0], rel=0.06)


def test_a_flight_without_speeds_gives_thrusts(tmp_path: Path) -> None:
    draft = draft_vehicle([write_flight(tmp_path / "commands.csv", 5, speeds=False)], arm=0.1)
    assert draft.force_mode
    assert draft.values["mass"].is_assumed
    assert any("--mass-kg" in question for question in draft.questions)
    assert draft.values["lag"].is_assumed


def test_a_layout_that_the_flight_contradicts_is_replaced(flights: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    places = np.array([(x, -y, 0.0) for x, y in BETAFLIGHT_X[0]])
    turned = RotorLayout(count=4, places=places, spins=(1, -1, -1, 1), source="the frame")
    monkeypatch.setattr(vehicle_from_log, "layout_in_log", lambda path, count: turned)
    draft = draft_vehicle(flights[:1], mass=MASS, arm=0.1)
    assert draft.spins == BETAFLIGHT_X[1]
    np.testing.assert_array_equal(np.sign(draft.places[:, :2]), np.sign(BETAFLIGHT_X[0]))
    assert len(draft.notes) == 1


def px4(side: float, moment: float = 0.05) -> dict[str, float]:
    places = ((side, side), (-side, -side), (side, -side), (-side, side))
    rows = {f"CA_ROTOR{k}_P{axis}": p for k, place in enumerate(places) for axis, p in zip("XY", place, strict=True)}
    return rows | {f"CA_ROTOR{k}_KM": moment * (1 if k < 2 else -1) for k in range(4)} | {"CA_ROTOR_COUNT": 4.0}


def test_arms_of_1_m_and_the_default_moment_are_placeholders() -> None:
    real, placeholder = _px4_layout(px4(0.2, 0.02), 4), _px4_layout(px4(1.0), 4)
    assert (real.has_lengths, real.torque_ratio) == (True, 0.02)
    assert (placeholder.has_lengths, placeholder.torque_ratio) == (False, None)
    assert real.places is not None
    np.testing.assert_allclose(real.places[0], (0.2, -0.2, 0.0))
    assert real.spins == (1, 1, -1, -1)
    with pytest.raises(DataError):
        _px4_layout(px4(0.2), 6)


def test_the_command_writes_a_file_that_loads(
    flights: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "vehicle.yaml"
    assert main(["robot", "from-log", str(flights[0]), "--out", str(out), "--mass-kg", "0.5", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    robot = robot_by_name(out)
    assert robot.body.mass == 0.5
    assert [mount.spin for mount in robot.mounts.layout] == list(BETAFLIGHT_X[1])
    assert all(
        value["origin"].split(":")[0].split(" [")[0] in ("given", "logged", "measured here", "assumed")
        for value in result["values"].values()
    )
    assert any("--arm-m" in question for question in result["questions"])
    assert (tmp_path / "vehicle.mapping.yaml").exists()


def test_a_log_without_flight_is_refused(flights: list[Path], tmp_path: Path) -> None:
    table = pd.read_csv(flights[0]).iloc[:800]
    table.to_csv(tmp_path / "short.csv", index=False)
    with pytest.raises(DataError):
        draft_vehicle([tmp_path / "short.csv"])
