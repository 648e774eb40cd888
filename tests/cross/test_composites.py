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
OCTAROTOR = [
    base(0.3, 0.0, 0.0, 0.0),
    *((0.1, (x, y, z), (0.0, 0.0, 0.0)) for x in (-0.1732051, 0.1732051) for y in (-0.1732051, 0.1732051)
      for z in (-0.1732051, 0.1732051)),
]  # fmt: skip
MORPHY = [
    base(0.225, 0.0004225, 0.0004225, 0.000845),
    *((0.01625, (x * (0.04 + 0.07 * 0.5**0.5), y * (0.032 + 0.07 * 0.5**0.5), 0.0), (0.0, 0.0, 0.0))
      for x in (-1, 1) for y in (-1, 1)),
]  # fmt: skip
"""Arms of 0.07 m at 45 degrees."""

PARTS: dict[str, list[Part]] = {
    "lmf1": quad(base(1.195, 0.013, 0.014, 0.013), 0.01, 0.1),
    "lmf2": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "magpie": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "base_quad_root_link_control": quad(base(1.2, 0.013, 0.014, 0.013), 0.01, 0.1),
    "x500": X500,
    "coaxial_octarotor": [*X500, *UNDER],
    "tilt_tricopter": [
        base(1.4, 0.0139, 0.0139, 0.0246),
        *((0.064, (0.2460732 * x, 0.2460732 * y, 0.0), (1e-6, 1e-6, 1e-6))
          for x, y in ((0.5, -0.75**0.5), (0.5, 0.75**0.5), (-1.0, 0.0))),
    ],
    "typhoon_hexarotor": TYPHOON,
    "tilted_hexarotor": TYPHOON,
    "base_quadrotor": [
        base(0.225, 0.0, 0.0, 0.0),
        *((0.00625, (x, y, 0.0), (0.0, 0.0, 0.0)) for x in (-0.13, 0.13) for y in (-0.13, 0.13)),
    ],
    "base_octarotor": OCTAROTOR,
    "base_rov": OCTAROTOR,
    **dict.fromkeys(("morphy", "morphy_fixed_base", "morphy_stiff"), MORPHY),
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


@pytest.mark.parametrize(("robot", "rods"), [("snakey", 4), ("snakey5", 5), ("snakey6", 6)])
def test_a_snake_is_a_polygon_of_its_rods(robot: str, rods: int) -> None:
    """Rods of 0.3 kg with a rotor of 6.25 g each, 1 m long and 0.02 m thick, about the middle, half their length / tan(pi / n)
    from each: ``I_z = n m (l²/12 + r²/4 + a²)``, and of n equal headings ``I_x = I_y = n m (l²/12 + 3 r²/4 + a²) / 2``."""
    mass, radius, away = 0.30625, 0.02, 0.5 / np.tan(np.pi / rods)
    across, along = 1.0 / 12.0 + radius**2 / 4.0, radius**2 / 2.0
    flat, turn = 0.5 * rods * mass * (across + along + away**2), rods * mass * (across + away**2)
    body = ROBOTS.get(robot).body
    assert body.mass == pytest.approx(rods * mass, rel=1e-9)
    np.testing.assert_allclose(body.com, (0.0, away, 0.0), rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(body.inertia, np.diag((flat, flat, turn)), rtol=0.0, atol=1e-6 * turn)


def test_the_simulator_that_counts_motors_twice_doubles_the_inertia() -> None:
    right, reference = (ROBOTS.get(f"base_quadrotor{end}").body for end in ("", "_doubled_inertia"))
    assert reference.mass == right.mass
    np.testing.assert_allclose(reference.inertia, 2.0 * np.array(right.inertia), rtol=1e-12)


def test_base_random_is_the_sum_of_its_motors_about_its_origin() -> None:
    """A base of 0.225 kg and motors of 3.125 g, all points, moments about the origin; to 1e-6 of the largest. Its centre of
    mass is declared there as well, where the published allocation takes its moments: that of the parts is 23 mm away."""
    robot = ROBOTS.get("base_random")
    motors = [(0.003125, mount.position, (0.0, 0.0, 0.0)) for mount in robot.mounts.layout]
    mass, com, inertia = composite([base(0.225, 0.0, 0.0, 0.0), *motors])
    at_origin = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    assert robot.body.mass == pytest.approx(mass, rel=1e-9)
    np.testing.assert_allclose(robot.body.inertia, at_origin, rtol=0.0, atol=1e-6 * at_origin.max())
    assert robot.body.com == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(com, [0.0224, 0.0018, -0.0026], atol=5e-5)


TINYPROP = ((1.5914e-3, -4.4e-6, 1.0e-7), (-4.4e-6, 1.5312e-3, 3.1e-6), (1.0e-7, 3.1e-6, 2.5329e-3))
"""Table 4 of the appendix of the Aerial Gym Simulator [kg m²], identified on the whole vehicle."""


def test_tinyprop_is_as_published_and_no_sum_of_the_parts_of_its_urdf() -> None:
    """Motors of 13 g at (±0.16, ±0.16) m alone have more about z than was identified of the whole: 2.66e-3 > 2.53e-3 kg m²."""
    body = ROBOTS.get("tinyprop").body
    assert body.mass == pytest.approx(0.321 + 4 * 0.013, rel=1e-9)
    assert body.com == (0.0, 0.0, 0.0)
    np.testing.assert_allclose(body.inertia, TINYPROP, rtol=1e-6)
    places = [(x, y, 0.0) for x in (-0.16, 0.16) for y in (-0.16, 0.16)]
    motors = composite([(0.013, place, (0.0, 0.0, 0.0)) for place in places])[2]
    assert motors[2, 2] > 1.05 * body.inertia[2][2]
