"""Drafts of mappings: any names, units and frames give back the flight of this package's own layout."""

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.cli.log import InspectLogCmd
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.sim2real.logs.column_names import parse_column_name
from aerial_gym.sim2real.logs.mapping_draft import draft_mapping
from aerial_gym.sim2real.logs.readers.flight_log import open_log
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import topics, write_ulog

NED = Rotation.from_matrix([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.array([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """A flight whose accelerometer and gyro agree with its motion, and whose axes differ."""
    own = flight(5, seconds=8.0, rate=100.0)
    t = own["t"].to_numpy()
    angles = np.stack((0.3 * np.sin(1.3 * t), 0.2 * np.sin(1.9 * t + 1.0), 0.5 * np.sin(0.7 * t)), axis=1)
    turns = Rotation.from_euler("xyz", angles)
    force = np.stack((0.1 * np.sin(t), 0.2 * np.cos(2.0 * t), 9.8 + np.sin(1.1 * t)), axis=1)
    acceleration = turns.apply(force) - (0.0, 0.0, 9.80665)
    velocity = np.cumsum(acceleration, axis=0) * 0.01
    middle = (turns[:-1].inv() * turns[1:]).as_rotvec() / 0.01
    own[["q_x", "q_y", "q_z", "q_w"]] = turns.as_quat()
    own[["omega_x", "omega_y", "omega_z"]] = np.concatenate((middle[:1], 0.5 * (middle[1:] + middle[:-1]), middle[-1:]))
    own[["acc_x", "acc_y", "acc_z"]], own[["v_x", "v_y", "v_z"]] = force, velocity
    own[["p_x", "p_y", "p_z"]] = np.cumsum(velocity, axis=0) * 0.01
    return own


@pytest.mark.parametrize(
    ("world", "body", "first", "with_force"), [*product(("enu", "ned"), ("flu", "frd"), (True, False), (True, False))]
)
def test_each_frame_and_order_is_found(
    table, tmp_path: Path, world: str, body: str, first: bool, with_force: bool
) -> None:
    turns = Rotation.from_quat(table[["q_x", "q_y", "q_z", "q_w"]].to_numpy())
    signs = FRD if body == "frd" else np.ones(3)
    turns = turns * Rotation.from_matrix(np.diag(signs)) if body == "frd" else turns
    turns = NED * turns if world == "ned" else turns
    columns = {"stamp": np.round(1e6 * table["t"]).astype(int)}
    for name, vectors in (("Position", "p"), ("Velocity", "v")):
        values = table[[f"{vectors}_{axis}" for axis in "xyz"]].to_numpy() * (1000.0 if name == "Position" else 1.0)
        values = values[:, [1, 0, 2]] * (1.0, 1.0, -1.0) if world == "ned" else values
        columns |= {f"{name} {axis}": values[:, i] for i, axis in enumerate("xyz")}
    quaternion = turns.as_quat()[:, [3, 0, 1, 2]] if first else turns.as_quat()
    columns |= {f"q[{i}]": quaternion[:, i] for i in range(4)}
    rates = np.degrees(table[["omega_x", "omega_y", "omega_z"]].to_numpy()) * signs
    columns |= {f"gyro{axis.upper()}": rates[:, i] for i, axis in enumerate("xyz")}
    columns |= {f"gyro_setpoint_{axis}": 0.9 * rates[:, i] for i, axis in enumerate("xyz")}
    if with_force:
        force = table[["acc_x", "acc_y", "acc_z"]].to_numpy() * signs / 9.80665
        columns |= {["ax_b", "ay_b", "az_b"][i]: force[:, i] for i in range(3)}
    speeds = table.filter(like="rotor_").to_numpy()
    columns |= {f"motor{i}_rpm": speeds[:, i] * 30.0 / np.pi for i in range(4)}
    path = tmp_path / "foreign.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    draft = draft_mapping(path)
    assert draft.open_questions == ()
    (tmp_path / "draft.yaml").write_text(draft.as_yaml())
    mapping = find_mapping(tmp_path / "draft.yaml")
    assert mapping == draft.mapping
    log = open_log(path, mapping).flight(1)
    own = tmp_path / "own.csv"
    table.to_csv(own, index=False)
    expected = open_log(own).flight(1)
    for name in ("position", "lin_vel", "ang_vel", *(("specific_force",) if with_force else ())):
        np.testing.assert_allclose(getattr(log, name), getattr(expected, name), atol=1e-5)
    turned = (Rotation.from_quat(log.attitude) * Rotation.from_quat(expected.attitude).inv()).magnitude()
    assert turned.max() < 1e-6
    assert log.rotor_speed is not None
    assert expected.rotor_speed is not None
    np.testing.assert_allclose(log.rotor_speed, expected.rotor_speed, rtol=1e-9)


@pytest.mark.parametrize(
    ("column", "words", "component", "unit"),
    [
        ("Angular velocity x [rad/s]", ("angular", "velocity"), "x", "rad/s"),
        ("gyroADC[0]", ("gyro", "adc"), "0", ""),
        ("vx", ("v",), "x", ""),
        ("fz_b", ("f", "b"), "z", ""),
        ("rotor_12", ("rotor",), "12", ""),
        ("motor3_rpm", ("motor", "rpm"), "3", ""),
        ("gyro_y_deg_s", ("gyro", "deg", "s"), "y", ""),
        ("t", ("t",), "", ""),
    ],
)
def test_names_are_taken_apart(column: str, words: tuple[str, ...], component: str, unit: str) -> None:
    part = parse_column_name(column)
    assert (part.words, part.component, part.unit) == (words, component, unit)


def test_a_hover_leaves_the_order_of_the_quaternion_open(tmp_path: Path) -> None:
    """Without turns and without acceleration nothing tells the frames."""
    t = np.arange(0.0, 5.0, 0.01)
    noise = np.random.default_rng(0).normal(size=(t.size, 6)) * 1e-3
    quaternion = Rotation.from_rotvec(noise[:, :3]).as_quat()
    columns = {"t": t} | {f"q{axis}": quaternion[:, i] for i, axis in enumerate("xyzw")}
    columns |= {f"w{axis}": noise[:, 3 + i] for i, axis in enumerate("xyz")}
    pd.DataFrame(columns).to_csv(tmp_path / "hover.csv", index=False)
    assert len(draft_mapping(tmp_path / "hover.csv").open_questions) == 1


@pytest.mark.parametrize("columns", [{"speed": np.ones(50)}, {"t": np.zeros(50), "x": np.ones(50)}])
def test_a_file_without_times_is_refused(columns, tmp_path: Path) -> None:
    pd.DataFrame(columns).to_csv(tmp_path / "a.csv", index=False)
    with pytest.raises(DataError, match="no column of times"):
        draft_mapping(tmp_path / "a.csv")


def test_a_log_of_a_known_format_needs_no_draft(table: pd.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="format ulog"):
        draft_mapping(write_ulog(tmp_path / "a.ulg", topics(table)))


def test_a_mapping_that_exists_is_kept(table: pd.DataFrame, tmp_path: Path) -> None:
    table.to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "m.yaml").write_text("corrected by hand")
    with pytest.raises(ConfigError, match="remove it, or name another file"):
        InspectLogCmd(log=tmp_path / "a.csv", draft_mapping=tmp_path / "m.yaml").run()
    assert (tmp_path / "m.yaml").read_text() == "corrected by hand"
