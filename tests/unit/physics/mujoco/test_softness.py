"""The compliance of a contact in MuJoCo: its limits, and the bounds that keep any motion stable."""

import pytest

from aerial_gym.config.contact import ContactCfg
from aerial_gym.physics.mujoco.mjcf import contact_softness, solver_numbers


def test_short_steps_have_the_very_spring_and_damper() -> None:
    cfg = ContactCfg(friction=0.5, damping_ratio=0.3)
    (stiffness, damping), (impedance, *_) = solver_numbers(cfg, 1e-6)
    assert -stiffness == pytest.approx(cfg.stiffness, rel=1e-3)
    assert -damping == pytest.approx(cfg.damping, rel=1e-3)
    assert impedance == pytest.approx(1e-4, rel=1.0)


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 4e-3, 0.02, 1.0])
@pytest.mark.parametrize("sinking", [1e-5, 1e-3, 0.05])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.5, 1.0, 4.0])
def test_no_motion_is_too_fast_for_its_step(dt: float, sinking: float, damping_ratio: float) -> None:
    """``dt b / d <= 1``, an equality where damping is above critical, and ``dt² k / d <= 1 / 4``; MuJoCo's limits of d
    hold. At its largest impedance MuJoCo leaves no more softening: the bounds are then kept by that alone, to its
    1e-4."""
    cfg = ContactCfg(friction=0.5, sinking=sinking, damping_ratio=damping_ratio)
    (stiffness, damping), (impedance, *_) = solver_numbers(cfg, dt)
    assert 1e-4 <= impedance <= 1.0 - 1e-4
    if contact_softness(cfg, dt) > 1e-4:
        assert dt * -damping / impedance <= 1.0 + 1e-9
        assert dt**2 * -stiffness / impedance <= 0.25 + 1e-9
        if damping_ratio >= 1.0 and impedance > 1e-4:
            assert dt * -damping / impedance == pytest.approx(1.0)
