"""Mass, centre of mass and inertia of robots against an independent engine (MuJoCo), from the parts that their sources list."""

from collections.abc import Sequence

import numpy as np
import pytest

from aerial_gym.robots import ROBOTS

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")

Part = tuple[float, tuple[float, float, float], tuple[float, float, float]]
"""Mass [kg], place of its centre of mass [m] and moments of inertia about it [kg m²]."""


def quad(base: Part, motor: float, arm: float) -> list[Part]:
    """Return a base and four motors at (±arm, ±arm), each with 1e-6 kg m² of its own, as the URDF files have them."""
    places = [(x, y, 0.0) for x in (-arm, arm) for y in (-arm, arm)]
    return [base, *((motor, place, (1e-6, 1e-6, 1e-6)) for place in places)]


def base(mass: float, *moments: float) -> Part:
    return mass, (0.0, 0.0, 0.0), (moments[0], moments[1], moments[2])


X500 = quad(base(1.4, 0.0139, 0.0139, 0.0246), 0.064, 0.174)
UNDER = [(0.064, (x, y, -0.07), (1e-6, 1e-6, 1e-6)) for x in (-0.174, 0.174) for y in (-0.174, 0.174)]
TYPHOON: list[Part] = [
    (2.02, (0.001005, 0.0, -0.0090035), (0.011, 0.015, 0.021)),
    *((0.005, (-0.00187896, y, 0.0822169), (0.0, 0.0, 0.0)) for y in (-0.242705, 0.242705)),
    *((0.005, (0.211396, y, 0.082219), (0.0, 0.0, 0.0)) for y in (-0.119762, 0.119762)),
    *((0.005, (-0.209396, y, 0.082219), (0.0, 0.0, 0.0)) for y in (-0.122762, 0.122762)),
]
PARTS: dict[str, list[Part]] = {
    "lmf1": quad(base(1.195, 0.013, 0.014, 0.013), 0.01, 0.1),
    "lmf2": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "magpie": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "base_quad_root_link_control": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "x500": X500,
    "coaxial_octarotor": [*X500, *UNDER],
    "typhoon_hexarotor": TYPHOON,
    "tilted_hexarotor": TYPHOON,
    "base_quadrotor": [
        base(0.225, 0.0, 0.0, 0.0),
        *((0.00625, (x, y, 0.0), (0.0, 0.0, 0.0)) for x in (-0.13, 0.13) for y in (-0.13, 0.13)),
    ],
    "base_octarotor": [
        base(0.3, 0.0, 0.0, 0.0),
        *((0.1, (x, y, z), (0.0, 0.0, 0.0)) for x in (-0.1732051, 0.1732051) for y in (-0.1732051, 0.1732051)
          for z in (-0.1732051, 0.1732051)),
    ],
}  # fmt: skip


def composite(parts: Sequence[Part]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre of mass and inertia about it, of bodies that are welded together."""
    bodies = "".join(
        f'<body pos="{x} {y} {z}"><inertial pos="0 0 0" mass="{mass}" diaginertia="{max(ix, 1e-15)} {max(iy, 1e-15)} '
        f'{max(iz, 1e-15)}"/></body>'
        for mass, (x, y, z), (ix, iy, iz) in parts
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler boundmass="0" boundinertia="0" balanceinertia="true"/><worldbody><body><freejoint/>'
        f'<inertial pos="0 0 0" mass="1e-12" diaginertia="1e-15 1e-15 1e-15"/>{bodies}</body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    at_origin = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, at_origin)
    mass, com = float(model.body_subtreemass[1]), np.asarray(data.subtree_com[1])
    return mass, com, at_origin[3:, 3:] - mass * (com @ com * np.eye(3) - np.outer(com, com))


@pytest.mark.parametrize("robot", PARTS)
def test_a_robot_is_the_sum_of_the_parts_of_its_source(robot: str) -> None:
    """To 1e-6 of the largest moment and to 1e-6 m: the engine welds the parts, we declare the whole."""
    mass, com, inertia = composite(PARTS[robot])
    body = ROBOTS.get(robot).body
    assert body.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(body.com, com, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(body.inertia, inertia, rtol=0.0, atol=1e-6 * inertia.max())


def test_the_simulator_that_counts_motors_twice_doubles_the_inertia() -> None:
    right, theirs = (ROBOTS.get(f"base_quadrotor{end}").body for end in ("", "_doubled_inertia"))
    assert theirs.mass == right.mass
    np.testing.assert_allclose(theirs.inertia, 2.0 * np.array(right.inertia), rtol=1e-12)
