"""A URDF as one rigid body: closed forms of the parallel axis theorem."""

from pathlib import Path

import numpy as np
import pytest

from aerial_gym.assets.urdf import urdf_body
from aerial_gym.errors import ConfigError

pytest.importorskip("yourdfpy")


def link(name: str, mass: float, inertia: tuple[float, float, float], origin: str = "") -> str:
    ixx, iyy, izz = inertia
    return (
        f'<link name="{name}"><inertial>{origin}<mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(child: str, xyz: str, rpy: str = "0 0 0") -> str:
    return (
        f'<joint name="to_{child}" type="fixed"><parent link="base"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/></joint>'
    )


def urdf(folder: Path, *parts: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot">{"".join(parts)}</robot>')
    return path


def test_a_base_with_four_motors(tmp_path: Path) -> None:
    """Parity 2.4: 0.225 kg with (4.225e-4, 4.225e-4, 8.45e-4) and four of 6.25 g at (+-.13, +-.13): 0.25 kg, doubled."""
    corners = [f"{x} {y} 0" for x in (-0.13, 0.13) for y in (-0.13, 0.13)]
    motors = [link(f"motor_{i}", 0.00625, (0.0, 0.0, 0.0)) + joint(f"motor_{i}", xyz) for i, xyz in enumerate(corners)]
    body = urdf_body(urdf(tmp_path, link("base", 0.225, (4.225e-4, 4.225e-4, 8.45e-4)), *motors))
    assert body.mass == pytest.approx(0.25)
    np.testing.assert_allclose(body.com, 0.0, atol=1e-12)
    np.testing.assert_allclose(body.inertia, np.diag([8.45e-4, 8.45e-4, 1.69e-3]), rtol=1e-9, atol=1e-15)


def test_a_turned_link_off_the_centre(tmp_path: Path) -> None:
    """A rod along its own z, turned by 90 degrees about x, lies along y; two bodies turn about their common centre."""
    rod = link("rod", 1.0, (0.3, 0.3, 0.0), '<origin xyz="0 0 0.5" rpy="0 0 0"/>')
    path = urdf(tmp_path, link("base", 3.0, (0.1, 0.2, 0.3)), rod, joint("rod", "1 0 0", "1.5707963267948966 0 0"))
    body = urdf_body(path)
    place = np.array([1.0, -0.5, 0.0])  # the rod's own z is -y of the base
    np.testing.assert_allclose(body.com, place / 4.0, atol=1e-12)
    reduced = 0.75  # kg, of 3 kg and 1 kg
    orbit = reduced * (place @ place * np.eye(3) - np.outer(place, place))
    np.testing.assert_allclose(body.inertia, np.diag([0.4, 0.2, 0.6]) + orbit, atol=1e-12)


def test_no_mass_is_no_body(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no link has a mass"):
        urdf_body(urdf(tmp_path, '<link name="base"/>'))
