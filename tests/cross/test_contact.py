"""Contact in the fused kernel and in scenes against the torch reference, and against an independent engine (MuJoCo)."""

import pytest
import torch

from aerial_gym.assets.sweep import NEAR
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.interop.streams import one_thread
from aerial_gym.math.quaternion import quat_normalize
from aerial_gym.physics import BodyState, TorchBackend, WarpBackend
from tests.physics.contact_rig import BALL, FEET, GRAVITY, INERTIA, MASS, GroundRig, ObstacleRig, obstacle, start
from tests.physics.vehicles import F64, asymmetric_robot

ROUGH = ContactCfg(friction=0.5)


def low_starts(count: int, dtype: torch.dtype) -> BodyState:
    """Return slightly tilted vehicles that are about to land, or have just done so, with speeds and spins of order one."""
    g = torch.Generator().manual_seed(2)
    q = torch.cat((0.1 * torch.randn(count, 3, dtype=F64, generator=g), torch.ones(count, 1, dtype=F64)), dim=-1)
    v, w = (0.5 * torch.randn(count, 3, dtype=F64, generator=g) for _ in range(2))
    height = 0.03 + 0.02 * torch.randn(count, dtype=F64, generator=g)
    return start(count, height=height, dtype=dtype, attitude=quat_normalize(q), lin_vel=v, ang_vel=w)


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
def test_one_step_on_the_ground_is_that_of_torch(integrator: str, request: pytest.FixtureRequest) -> None:
    """Fused kernel and scene (a plane) against float64 torch: 64 vehicles with an offset centre of mass, one step of 10 ms.
    Float32 with the penalty R loses about ``PENALTY`` of 1e-7; a branch on the very edge may fall to the other side. The
    ground is tested at the poses, a scene also along the step and from a distance of ``NEAR`` on. What it flags beside is
    flagged by ground in steps of 0.1 ms, here a foot that leaves the ground, or by ground with feet larger by ``NEAR``."""
    if integrator == "rk4":
        request.getfixturevalue("optimise_kernels")
    count, robot = 64, asymmetric_robot()
    with one_thread():
        truth = GroundRig(
            TorchBackend(), ROUGH, low_starts(count, F64), spheres=FEET, robot=robot, integrator=integrator
        )
        truth.run(0.01, 0.01)
    fused = GroundRig(
        WarpBackend(), ROUGH, low_starts(count, torch.float32), spheres=FEET, robot=robot, integrator=integrator
    )
    fused.run(0.01, 0.01)
    scenes = [
        ObstacleRig(
            [ShapeCfg(kind="plane")], obstacle(count), ROUGH, low_starts(count, torch.float32), spheres=FEET,
            robot=robot, integrator=integrator, backend=backend,
        )
        for backend in (WarpBackend(), TorchBackend())
    ]  # fmt: skip
    for scene in scenes:
        scene.run(0.01)
    larger = tuple((x, y, z, radius + float(NEAR)) for x, y, z, radius in FEET)
    touches = truth.crashes
    for feet, dt in ((larger, 0.01), (FEET, 1e-4)):
        ground = GroundRig(
            TorchBackend(), ROUGH, low_starts(count, F64), spheres=feet, robot=robot, integrator=integrator
        )
        ground.run(0.01, dt)
        touches = touches | ground.crashes
    touched = truth.impulse[:, 2] > 0.0
    assert 16 < touched.sum() < 64
    for rig in (fused, *scenes):
        assert bool((rig.crashes | ~truth.crashes).all())
        assert bool((~rig.crashes | (truth.crashes if rig is fused else touches)).all())
        error = (torch.cat(rig.state.tensors(), -1) - torch.cat(truth.state.tensors(), -1)).abs().amax(dim=1)
        assert error.sort().values[:-1].max() < 2e-4  # all but one on an edge
        assert (rig.impulse - truth.impulse).abs().amax(dim=1).sort().values[:-1].max() < 1e-4


def test_landing_and_sliding_agree_with_mujoco() -> None:
    """A ball that comes down at an angle, and feet that slide: where and how they end, 0.5 s later. Both engines have other
    compliances of about 1 mm and 10 ms, over which the paths may differ: 1 % of the path, 3 % of the speed before rolling
    sets in."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
    level = tuple((x, y, r, r) for x, y, _, r in FEET)
    for spheres, height in ((BALL, 0.15), (level, 0.0)):
        geoms = "".join(f'<geom type="sphere" pos="{x} {y} {z}" size="{r}" mass="0"/>' for x, y, z, r in spheres)
        model = mujoco.MjModel.from_xml_string(f"""
          <mujoco><option timestep="2e-4" gravity="0 0 {-GRAVITY}" cone="elliptic" impratio="50"/>
          <default><geom friction="0.5 0 0" condim="3" solref="0.01 1" solimp="0.99 0.99 0.001"/></default>
          <worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 {height}"><freejoint/>
            <inertial pos="0 0 0" mass="{MASS}" diaginertia="{" ".join(map(str, INERTIA))}"/>{geoms}
          </body></worldbody></mujoco>""")
        data = mujoco.MjData(model)
        data.qvel[:3] = (1.0, 0.4, 0.0)
        for _ in range(2500):
            mujoco.mj_step(model, data)
        rig = GroundRig(
            WarpBackend(), ROUGH, start(height=height, dtype=torch.float32, lin_vel=(1.0, 0.4, 0.0)), spheres=spheres
        )
        rig.run(0.5, 0.002)
        place, reference = rig.state.position[0].double(), torch.tensor(data.qpos[:3])
        assert (place - reference)[:2].norm() < 0.01 * reference[:2].norm()
        assert abs(place[2] - reference[2]) < 2e-3
        torch.testing.assert_close(rig.state.lin_vel[0].double(), torch.tensor(data.qvel[:3]), rtol=0.0, atol=0.03)
        torch.testing.assert_close(rig.state.ang_vel[0].double(), torch.tensor(data.qvel[3:]), rtol=0.03, atol=0.03)
