"""Inertial measurement units: shipped values, and what is refused with which words."""

from dataclasses import replace
from math import inf, nan

import pytest

from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.sensors import IMUS

G = 9.80665
PI_180 = 3.141592653589793 / 180.0


def test_shipped_imus_hold_the_values_of_aerial_gym() -> None:
    """parity.md 3.6; of VN-100 and BMI088 the data sheets' densities per sqrt(Hz) and full scales: 16 and 24 g, 2000 deg/s."""
    base, vn100, bmi088 = (IMUS.get(name) for name in ("base_imu", "vn100", "bmi088"))
    assert base.accel_noise_density == pytest.approx([0.001688956] * 3, rel=1e-6)
    assert base.gyro_noise_density == pytest.approx([0.001067934] * 3, rel=1e-6)
    assert vn100.accel_noise_density == pytest.approx([0.14e-3 * G] * 3, rel=1e-6)
    assert vn100.gyro_noise_density == pytest.approx([0.0035 * PI_180] * 3, rel=1e-6)
    assert bmi088.accel_noise_density == pytest.approx([160e-6 * G, 160e-6 * G, 190e-6 * G], rel=1e-6)
    assert bmi088.gyro_noise_density == pytest.approx([0.014 * PI_180] * 3, rel=1e-6)
    for cfg in (base, vn100):
        assert cfg.accel_bias_walk == pytest.approx([9.7828e-7] * 3, rel=1e-5)
        assert cfg.gyro_bias_walk == pytest.approx([2.65416e-5] * 3, rel=1e-5)
    assert bmi088.accel_bias_walk == pytest.approx([0.001356466] * 3, rel=1e-6)
    assert bmi088.gyro_bias_walk == pytest.approx([1.435270e-5] * 3, rel=1e-6)
    for cfg, misalignment in ((base, 0.0), (vn100, 2.0), (bmi088, 2.0)):
        assert cfg.misalignment_deg == (misalignment,) * 3
        assert cfg.accel_initial_bias == cfg.gyro_initial_bias == (1e-3,) * 3
        assert cfg.position == cfg.euler == (0.0, 0.0, 0.0)
    assert (base.accel_range, base.gyro_range) == (100.0, 10.0)
    assert (vn100.accel_range, vn100.gyro_range) == pytest.approx((16.0 * G, 2000.0 * PI_180), rel=1e-5)
    assert (bmi088.accel_range, bmi088.gyro_range) == pytest.approx((24.0 * G, 2000.0 * PI_180), rel=1e-5)


def test_unknown_names_list_what_exists() -> None:
    with pytest.raises(UnknownNameError, match=r"no IMU 'vn10'. Did you mean 'vn100'\? Known: base_imu, bmi088, vn100"):
        IMUS.get("vn10")


@pytest.mark.parametrize(("fields", "message"), [
    ({"accel_range": 0.0}, r"ImuCfg.accel_range = 0.0: must be > 0 and finite"),
    ({"gyro_range": inf}, r"ImuCfg.gyro_range = inf: must be > 0 and finite"),
    ({"position": (0.0, nan, 0.0)}, r"ImuCfg.position = .*: must be finite"),
    ({"euler": (0.0, 90.0, 0.0)}, r"ImuCfg.euler = .*: must lie within \+-2 pi. Angles are in radians"),
    ({"euler": (nan, 0.0, 0.0)}, r"ImuCfg.euler = "),
    ({"misalignment_deg": (0.0, 46.0, 0.0)}, r"ImuCfg.misalignment_deg = .*: must lie within 0 and 45 degrees"),
    ({"misalignment_deg": (0.0, -1.0, 0.0)}, r"ImuCfg.misalignment_deg"),
    *(
        ({f"{kind}_{name}": (0.0, bad, 0.0)}, rf"ImuCfg.{kind}_{name} = .*: must be >= 0 and finite")
        for kind in ("accel", "gyro")
        for name in ("noise_density", "bias_walk", "initial_bias")
        for bad in (-1e-9, nan, inf)
    ),
])  # fmt: skip
def test_impossible_imus_are_refused(fields: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        replace(IMUS.get("vn100"), **fields)
