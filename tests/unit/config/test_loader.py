"""Configurations: loading, writing back, and every refusal by name."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym import ENVIRONMENTS, ROBOTS, SIMS
from aerial_gym.config import build, dump_yaml, load
from aerial_gym.config.robot import BodyCfg, InitialStateCfg, MountCfg, RotorCfg
from aerial_gym.config.sensor import load_sensor
from aerial_gym.config.sim import SimCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sensors import IMUS, SENSORS

BODY = {"mass": 1.0, "inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1.5e-3]], "source": "test"}
ROTOR = {"thrust_map": [0.0, 0.0, 1e-6], "torque_ratio": 0.01, "thrust_range": [0.0, 2.0], "source": "test"}
ROTOR |= {"time_constant_up": 0.04, "time_constant_down": 0.04}


SHIPPED = {"robot": ROBOTS, "environment": ENVIRONMENTS, "IMU": IMUS, "sensor": SENSORS, "simulation": SIMS}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, family in SHIPPED.items() for name in family.names()]
)
def test_every_configuration_survives_writing_and_reading(kind: str, name: str, tmp_path: Path) -> None:
    path, cfg = tmp_path / "cfg.yaml", SHIPPED[kind].get(name)
    path.write_text(dump_yaml(cfg), encoding="utf-8")
    assert (load_sensor(path) if kind == "sensor" else load(type(cfg), path)) == cfg


@pytest.mark.parametrize("name", ROBOTS.names())
def test_every_robot_can_hover_inside_its_thrust_limits_and_names_its_sources(name: str) -> None:
    robot = ROBOTS.get(name)
    for rotor in robot.rotor_types:
        low, high = rotor.thrust_range
        assert low < robot.body.mass * 9.81 / robot.num_rotors < 0.9 * high
    for part in (robot.body, *robot.rotor_types, robot.mounts, robot.collision):
        assert len(part.source) > 10


def test_tinyprop_is_table_4_of_the_appendix() -> None:
    robot = ROBOTS.get("tinyprop")
    assert robot.body.mass == 0.373
    np.testing.assert_allclose(np.diag(robot.body.inertia), [1.5914e-3, 1.5312e-3, 2.5329e-3], rtol=1e-6)
    np.testing.assert_allclose(robot.rotor.thrust_map[2] * (2 * np.pi) ** 2, 1.286412e-5, rtol=1e-6)
    hover = robot.rotor.speed_for_thrust(0.373 * 9.81 / 4)
    np.testing.assert_allclose(hover / (2 * np.pi), 266.7, atol=0.1)


def test_numbers_written_with_an_exponent_and_no_point_are_numbers(tmp_path: Path) -> None:
    path = tmp_path / "sim.yaml"
    path.write_text("summary: s\ndt: 1e-2\nsource: s\n")
    assert load(SimCfg, path).dt == 0.01


@pytest.mark.parametrize(("change", "message"), [
    ({"mass": 0.0}, "BodyCfg.mass = 0.0: must be > 0 and finite"),
    ({"mass": float("nan")}, "BodyCfg.mass = nan: must be > 0 and finite"),
    ({"mass": "heavy"}, "here: mass = 'heavy': must be float"),
    ({"inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 5e-3]]}, "violate the triangle inequality"),
    ({"inertia": [[1e-3, 0, 0], [0, -1e-3, 0], [0, 0, 1e-3]]}, "principal moments must be > 0"),
    ({"inertia": [[1e-3, 1e-4, 0], [0, 1e-3, 0], [0, 0, 1e-3]]}, "must be symmetric"),
    ({"inertia": [[1e-3, 0, 0], [0, 1e-3, 0]]}, "must have 3 entries"),
    ({"inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, float("inf")]]}, "must be finite"),
    ({"masss": 1.0}, "here: unknown field 'masss'. Did you mean 'mass'\\? Known: mass, inertia, com, source"),
])  # fmt: skip
def test_impossible_bodies_are_refused_by_name(change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(BodyCfg, {**BODY, **change}, where="here")


@pytest.mark.parametrize(("change", "message"), [
    ({"time_constant_up": -0.1}, "RotorCfg.time_constant_up = -0.1"),
    ({"thrust_range": [2.0, 1.0]}, "needs low < high, and high > 0"),
    ({"thrust_range": [-2.0, -1.0]}, "needs low < high, and high > 0"),
    ({"dead_band": -1.0}, "RotorCfg.dead_band = -1.0"),
    ({"slew_rate": 0.0}, "RotorCfg.slew_rate = 0.0"),
    ({"mode": "torque"}, "must be one of speed, force"),
    ({"mode": "force"}, "in force mode the state is the thrust; leave it out"),
    ({"reverse_thrust_map": [0.0, 0.0, 1e-6]}, "only for a reversible rotor"),
    ({"thrust_range": [-1.0, 1.0], "thrust_map": [0.1, 0.0, 1e-6]}, "is 0 without speed"),
    ({"thrust_map": [0.0, 1.0, 0.0]}, "the coefficient of w² must be > 0"),
    ({"torque_map": [0.0, 0.0, 1e-8]}, "exactly one of torque_ratio and torque_map"),
    ({"torque_ratio": None}, "exactly one of torque_ratio and torque_map"),
    ({"torque_ratio": -1.0}, "RotorCfg.torque_ratio = -1.0"),
])  # fmt: skip
def test_impossible_rotors_are_refused_by_name(change: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(RotorCfg, {**ROTOR, **change}, where="here")


def test_other_impossible_parts_are_refused() -> None:
    with pytest.raises(ConfigError, match="MountCfg.spin = 2: must be 1 or -1"):
        MountCfg(position=(0, 0, 0), spin=2)
    with pytest.raises(ConfigError, match="axis"):
        MountCfg(position=(0, 0, 0), axis=(0, 0, 0), spin=1)
    with pytest.raises(ConfigError, match="lin_vel_low"):
        InitialStateCfg(lin_vel_low=(1.0, 0.0, 0.0), lin_vel_high=(0.0, 0.0, 0.0))
    with pytest.raises(ConfigError, match="effects.rotor_drag.dx = nan"):
        replace(ROBOTS.get("tinyprop"), effects={"rotor_drag": {"dx": float("nan")}})


@pytest.mark.parametrize(("text", "message"), [
    ("a: [1, 2", "not valid YAML"),
    ("- 1\n- 2\n", "must hold a mapping of fields, found list"),
    ("summary: s\n", "field 'dt' is missing"),
])  # fmt: skip
def test_unreadable_files_are_named(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    with pytest.raises(ConfigError, match="no such file"):
        load(SimCfg, path)
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"{re.escape(str(path))}.*{message}"):
        load(SimCfg, path)


def test_torque_map_follows_the_ratio() -> None:
    rotor = build(RotorCfg, {**ROTOR, "thrust_map": [0.1, -1e-4, 1e-6]}, where="here")
    np.testing.assert_allclose(rotor.torque_coefficients, [1e-3, -1e-6, 1e-8])
    np.testing.assert_allclose(rotor.speed_for_thrust(0.1 - 1e-4 * 900 + 1e-6 * 900**2), 900.0)
