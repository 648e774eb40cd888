"""Inertia of thrown bodies of known shape, from public logs."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.teststand.inertia_study import ThrowSeries, study_inertia
from aerial_gym.sim2real.teststand.throws import steiner_term

LOGS = Path(__file__).parents[3] / "shared" / "data" / "real_logs" / "tumbling"
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not LOGS.exists(), reason="needs the logs of thrown bodies")]

FRAME_MASS, BLOCK_MASS = 0.1785, 0.0701
FRAME = np.diag((1.004, 2.994, 3.506)) * FRAME_MASS / 1452.0  # About its centre of mass [kg m²], axes of the IMU
FRAME_HEIGHT = -0.0189  # Of its centre of mass [m]
PROOF = (1.30097e-4, 1.67580e-4, 2.45083e-4)  # Cuboid of 346 g, 60 x 70 x 30.2 mm


def frame_with_blocks() -> tuple[float, np.ndarray]:
    """Return mass and inertia of the frame with four blocks of 15 x 15 x 40 mm."""
    places = np.array([((k - 4) * 18 + 9, (i - 2) * 18 + 9, -22) for i in (1, 2) for k in (0, 7)]) * 1e-3
    block = BLOCK_MASS / 12 * np.diag((0.015**2 + 0.04**2, 0.015**2 + 0.04**2, 2 * 0.015**2))
    own, mass = np.array((0.0, 0.0, FRAME_HEIGHT)), FRAME_MASS + 4 * BLOCK_MASS
    centre = (FRAME_MASS * own + BLOCK_MASS * places.sum(axis=0)) / mass
    blocks = sum(block + steiner_term(BLOCK_MASS, place - centre) for place in places)
    return mass, FRAME + steiner_term(FRAME_MASS, own - centre) + blocks


def moments_and_turn(name: str, paths: list[Path], mass: float, inertia: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the relative errors of the principal moments, and the angle between the axes [deg]."""
    device = ThrowSeries(paths=sorted(LOGS.glob("calibration_device*")), mass=0.10067)
    proof = ThrowSeries(paths=sorted(LOGS.glob("calibration_proof*")), mass=0.346, inertia=PROOF)
    result = study_inertia(ThrowSeries(paths=paths, mass=mass), device, proof, None).mapping
    estimates, truth = result["moments_kg_m2"], np.linalg.eigvalsh(inertia)
    assert isinstance(estimates, list)
    errors = np.array([each["value"] for each in estimates]) / truth - 1.0
    inside = [each["interval"][0] < value < each["interval"][1] for each, value in zip(estimates, truth, strict=True)]
    turn = float(np.degrees(Rotation.from_quat(result["axes_xyzw"]).magnitude()))  # type: ignore[arg-type]
    widths = np.array(result["axes_half_width_deg"])
    print(f"{name}: errors {np.round(100 * errors, 2)} %, axes {turn:.1f} deg, 95 % {np.round(widths, 1)} deg")
    assert all(inside)
    assert turn < 1.5 * widths.max()  # a turn about one axis moves two of them
    return errors, turn


@pytest.mark.parametrize(("name", "body"), [("config_empty", (FRAME_MASS, FRAME)), ("config_a", frame_with_blocks())])
def test_moments_of_known_bodies(name: str, body: tuple[float, np.ndarray]) -> None:
    paths = sorted(LOGS.glob(f"{name}*"))
    errors, turn = moments_and_turn(name, paths, *body)
    assert np.linalg.norm(errors * np.linalg.eigvalsh(body[1])) < 0.015 * np.linalg.norm(np.linalg.eigvalsh(body[1]))
    assert turn < 3.0
    for path in paths:
        single, _ = moments_and_turn(path.stem, [path], *body)
        assert np.abs(single).max() < 0.05
