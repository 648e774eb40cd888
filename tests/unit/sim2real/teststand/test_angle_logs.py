"""Joints from flights: a plant of MuJoCo, written here as XML, that shares no code with the engine that judges it.
Joints from flights whose logs do not have their angles: the MuJoCo plant of ``test_flown_joints``, felt at its core.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from aerial_gym.cli.main import main
from aerial_gym.config.joint import DriveCfg, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import BodyCfg, CollisionCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg, load_robot
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import ConfigError, DataError
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.articulated.joint_laws import JointLimits, Spring
from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real import close_loop, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.signals import log_at_equal_steps, num_edge_rows
from aerial_gym.sim2real.teststand.joints import joint_simulation
from aerial_gym.sim2real.teststand.joints.body_motion_fit import JointFitter, fit_hidden_joints
from aerial_gym.sim2real.teststand.joints.joint_motion import joint_efforts
from aerial_gym.sim2real.teststand.joints.joint_simulation import BodyMotion, JointLaws, JointSimulation, body_motion
from aerial_gym.sim2real.wording import text
from tests.physics.articulated.test_link_buoyancy import draw_state, make_joints, tree_state, under_water
from tests.physics.articulated.test_link_drag import fly, make_model
from tests.refusals import assert_refused

mujoco = pytest.importorskip("mujoco")

ARM, HINGE, TIP = 0.03, 0.05, 0.15
"""Mass of an arm [kg], and where its hinge and its rotor are along x and y [m], the diagonal being sqrt(2) of that."""

CORNERS = ((1, -1, 1), (-1, -1, -1), (-1, 1, 1), (1, 1, -1))  # Signs of x and y, and spin

STIFFNESS, DAMPING, REST = 1.2, 0.004, 0.0
THRUST, DRAG = 1.2e-6, 0.015
CORE = {"mass": 0.5, "inertia": (1.2e-3, 1.3e-3, 2.2e-3)}


def plant(springs: list[dict[str, float]]) -> str:
    arms = ""
    for number, (x, y, _) in enumerate(CORNERS):
        own = springs[number]
        arms += f"""
      <body name="arm{number}" pos="{x * HINGE} {y * HINGE} 0.01">
        <joint name="arm{number}" axis="{-y / 2**0.5} {x / 2**0.5} 0" stiffness="{own["stiffness"]}"
          damping="{own["damping"]}" springref="{np.degrees(own["rest"])}" frictionloss="{own["friction"]}"/>
        <inertial pos="{x * (TIP - HINGE)} {y * (TIP - HINGE)} 0" mass="{ARM}" diaginertia="2e-5 2e-5 3e-5"/>
        <site name="rotor{number}" pos="{x * (TIP - HINGE)} {y * (TIP - HINGE)} 0"/>
      </body>"""
    motors = "".join(
        f'<motor name="rotor{n}" site="rotor{n}" gear="0 0 1 0 0 {-spin * DRAG}"/>'
        for n, (_, _, spin) in enumerate(CORNERS)
    )
    a, b, c = CORE["inertia"]
    return f"""<mujoco><option timestep="0.0002" integrator="implicitfast" gravity="0 0 -9.80665"/><worldbody>
    <body name="core" pos="0 0 5"><freejoint/><inertial pos="0 0 0" mass="{CORE["mass"]}" diaginertia="{a} {b} {c}"/>{arms}
    </body></worldbody><actuator>{motors}</actuator></mujoco>"""


def flight(springs: list[dict[str, float]], seed: int, *, seconds: float = 12.0, noise: float = 1.0) -> pd.DataFrame:
    """Return a log at 250 Hz of a flight that a plain attitude law holds about hover while thrusts are shaken."""
    model = mujoco.MjModel.from_xml_string(plant(springs))
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    mass, every = CORE["mass"] + 4 * ARM, round(0.004 / model.opt.timestep)
    tones = rng.uniform(0.4, 6.0, (4, 6)), rng.uniform(0.0, 2 * np.pi, (4, 6))
    mix = np.array([(1.0, y * TIP, -x * TIP, -spin * DRAG) for x, y, spin in CORNERS]).T
    rows = []
    wanted = speed = np.full(4, np.sqrt(mass * 9.80665 / 4 / THRUST))
    for step in range(round(seconds / 0.004) * every):
        turn = data.xmat[1].reshape(3, 3)
        if step % every == 0:
            tilt = np.array([turn[2, 1], -turn[2, 0], 0.0])
            spin = data.qvel[3:6]
            torque = -np.array([0.25, 0.25, 0.0]) * tilt - np.array([0.03, 0.03, 0.02]) * spin
            lift = mass * (9.80665 + 1.5 * (5.0 - data.qpos[2]) - 2.0 * data.qvel[2])
            thrust = np.linalg.solve(mix, np.array([lift, *torque]))
            shake = 0.25 * np.sin(2 * np.pi * tones[0] * data.time + tones[1]).sum(axis=1)
            wanted = np.sqrt(np.clip(thrust + shake, 0.05, None) / THRUST)
        speed = speed + (wanted - speed) * model.opt.timestep / 0.02
        data.ctrl[:] = THRUST * speed**2
        if step % every == 0:
            mujoco.mj_forward(model, data)
            w, x, y, z = data.qpos[3:7]
            force = turn.T @ (data.qacc[:3] + np.array([0.0, 0.0, 9.80665]))
            values = (*data.qpos[:3], x, y, z, w, *data.qvel[:3], *data.qvel[3:6], *force, *speed, *data.qpos[7:])
            rows.append((data.time, *values))
        mujoco.mj_step(model, data)
    names = "t p_x p_y p_z q_x q_y q_z q_w v_x v_y v_z omega_x omega_y omega_z acc_x acc_y acc_z".split()  # noqa: SIM905
    angles = [f"joint_arm{n}" for n in range(4)]
    table = pd.DataFrame(rows, columns=[*names, *(f"rotor_{n}" for n in range(1, 5)), *angles])
    for columns, size in ((names[11:14], 0.003), (names[14:17], 0.05), (angles, 3e-4)):
        table[columns] += noise * size * rng.standard_normal((len(table), len(columns)))
    return table.iloc[250:].reset_index(drop=True)


def robot() -> RobotCfg:
    arm = np.diag((2e-5, 2e-5, 3e-5))
    places = [np.array((x * TIP, y * TIP, 0.01)) for x, y, _ in CORNERS]
    mass = CORE["mass"] + 4 * ARM
    com = ARM * sum(places) / mass
    whole = np.diag(CORE["inertia"]) + CORE["mass"] * (com @ com * np.eye(3) - np.outer(com, com))
    for place in places:
        lever = place - com
        whole = whole + arm + ARM * (lever @ lever * np.eye(3) - np.outer(lever, lever))

    def rows(matrix: np.ndarray):
        return tuple(tuple(float(v) for v in row) for row in matrix)

    return RobotCfg(
        summary="four arms on springs",
        body=BodyCfg(mass=mass, inertia=rows(whole), com=tuple(com.tolist()), source="invented"),
        rotor=RotorCfg(
            thrust_map=(0.0, 0.0, THRUST), torque_ratio=DRAG, time_constant_up=0.02, time_constant_down=0.02,
            thrust_range=(0.0, 8.0), source="invented",
        ),
        mounts=MountsCfg(
            layout=tuple(
                MountCfg(position=tuple(place.tolist()), spin=spin, link=f"arm{n}")
                for n, (place, (_, _, spin)) in enumerate(zip(places, CORNERS, strict=True))
            ),
            source="invented",
        ),
        joints=JointsCfg(
            layout=tuple(
                JointCfg(
                    name=f"arm{n}", axis=(-y / 2**0.5, x / 2**0.5, 0.0), position=(x * HINGE, y * HINGE, 0.01),
                    link=LinkCfg(mass=ARM, com=tuple(places[n].tolist()), inertia=rows(arm)),
                    spring=SpringCfg(stiffness=STIFFNESS, damping=DAMPING, rest=REST),
                )
                for n, (x, y, _) in enumerate(CORNERS)
            ),
            source="invented",
        ),
        collision=CollisionCfg(source="none"),
    )  # fmt: skip


SAME = {"stiffness": STIFFNESS, "damping": DAMPING, "rest": REST, "friction": 0.0}
HIDDEN = [SAME | {"stiffness": 0.9}, SAME | {"damping": 0.008, "rest": 0.04}, SAME | {"friction": 0.01}, SAME]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    folder = tmp_path_factory.mktemp("joints")
    (folder / "robot.yaml").write_text(dump_yaml(robot()))
    paths = []
    for seed in range(2):
        paths.append(folder / f"f{seed}.csv")
        flight(HIDDEN, seed).to_csv(paths[-1], index=False)
    given = ["identify", "joints", str(folder / "robot.yaml"), *map(str, paths), "--out", str(folder / "out")]
    assert main(given) == 0
    return json.loads((folder / "out" / "result.json").read_text()), folder


def test_what_is_hidden_in_each_joint_is_named_and_found(result: tuple[dict, Path]) -> None:
    """Without dry friction 1 % of stiffness, 2 % of damping, 1 mrad; beside it 3 %, 10 % and 5 mrad, and friction to 12 %."""
    joints = {joint["name"]: joint for joint in result[0]["joints"]}
    assert joints["arm0"]["changed"] == ["stiffness"]
    assert set(joints["arm1"]["changed"]) == {"damping", "rest"}
    assert "friction" in joints["arm2"]["changed"]
    assert joints["arm3"]["changed"] == []
    for number, hidden in enumerate(HIDDEN):
        joint, rubs = joints[f"arm{number}"], hidden["friction"] > 0.0
        params = {key: value["value"] for key, value in joint["laws"][joint["chosen"]]["params"].items()}
        assert params["stiffness"] == pytest.approx(hidden["stiffness"], rel=0.03 if rubs else 0.01)
        assert params["damping"] == pytest.approx(hidden["damping"], rel=0.1 if rubs else 0.02)
        assert params["rest"] == pytest.approx(hidden["rest"], abs=5e-3 if rubs else 1e-3)
        assert params.get("friction", 0.0) == pytest.approx(hidden["friction"], rel=0.12)
    for name, least in (("arm0", 20.0), ("arm1", 20.0), ("arm2", 3.0)):
        assert joints[name]["before"]["rms"] > least * joints[name]["after"]["rms"]


def test_the_robot_file_has_what_was_found(result: tuple[dict, Path]) -> None:
    results = load_robot(result[1] / "out" / "robot.yaml").joints
    springs = [joint.spring for joint in results.layout]
    assert springs[3] == SpringCfg(stiffness=STIFFNESS, damping=DAMPING, rest=REST)
    assert springs[2].friction == pytest.approx(0.01, rel=0.12)
    assert "identify joints: f0.csv, f1.csv" in results.source


def test_what_a_log_or_a_robot_lacks_is_said(result, tmp_path, capsys) -> None:
    table, path = pd.read_csv(result[1] / "f0.csv"), tmp_path / "f.csv"
    table.drop(columns="joint_arm2").to_csv(path, index=False)
    declared = str(result[1] / "robot.yaml")
    assert main(["identify", "joints", declared, str(path)]) == 2
    assert "has no angle of the joint arm2" in capsys.readouterr().err
    table.assign(joint_arm1=0.1).to_csv(path, index=False)
    assert main(["identify", "joints", declared, str(path)]) == 2
    assert "joint arm1: its angle is the same in all rows" in capsys.readouterr().err
    assert main(["identify", "joints", "base_quadrotor", str(path)]) == 2
    assert "this robot has no joints" in capsys.readouterr().err
    plain = robot()
    drive = DriveCfg(mode="effort", limit=1.0, command_range=(-1.0, 1.0))
    first = replace(plain.joints.layout[0], spring=None, drive=drive)
    driven = replace(plain, joints=replace(plain.joints, layout=(first, *plain.joints.layout[1:])))
    (tmp_path / "driven.yaml").write_text(dump_yaml(driven))
    assert main(["identify", "joints", str(tmp_path / "driven.yaml"), str(result[1] / "f0.csv")]) == 0
    assert text(Finding("joint_driven", "arm0")) in " ".join(capsys.readouterr().out.split())


BAND = 15.0


def without_angles(table: pd.DataFrame) -> pd.DataFrame:
    return table.drop(columns=[name for name in table.columns if name.startswith("joint_")])


def make_ride(table: pd.DataFrame, path: Path) -> BodyMotion:
    without_angles(table).to_csv(path, index=False)
    return body_motion(robot(), log_at_equal_steps(read_flight_log(path)), bandwidth=BAND)


@pytest.mark.slow
def test_what_a_body_feels_of_swinging_arms_is_what_that_of_the_plant_felt(tmp_path, monkeypatch) -> None:
    """The true springs leave a fifth of what the declared ones leave at most. To save time pieces begin a second
    before; half of it damped, a swing is forgotten to ``exp(-0.5 s c / 2 J)``, 0.19."""
    monkeypatch.setattr(joint_simulation, "SETTLE_S", 1.0)
    monkeypatch.setattr(joint_simulation, "USED_S", 0.7)
    hidden = [SAME | {"stiffness": 0.8}, SAME | {"damping": 0.008, "rest": 0.05}, SAME, SAME]
    ride = make_ride(flight(hidden, 3, seconds=3.4, noise=0.0), tmp_path / "f.csv")
    fit = JointFitter(robot(), [ride], BAND)
    true = np.array([hidden[k][name] for k, name in fit.parameter_owners])
    felt = fit.simulation.run(fit.joint_laws(np.stack((true, fit.declared))), torch.ones(2).double())[0][0]
    edge = num_edge_rows(ride.rate, BAND)
    left = (felt - ride.felt[None, fit.simulation.warm :])[:, edge:-edge]
    right, wrong = np.sqrt(np.mean((left - left.mean(axis=1, keepdims=True)) ** 2, axis=1))
    assert (right < 0.2 * wrong).all()


def test_effects_of_the_robot_file_push_the_links_too(tmp_path: Path) -> None:
    """Drag at the centre of mass, ``-d v``, is in the wrench on the base, in any number of rows."""
    table = flight([SAME] * 4, 5, seconds=3.2, noise=0.0)
    plain = make_ride(table, tmp_path / "f.csv")
    dragged = replace(robot(), effects={"rotor_drag": {"dx": 0.5, "dy": 0.5, "dz": 0.0}}, effects_source="invented")
    ride = body_motion(dragged, log_at_equal_steps(read_flight_log(tmp_path / "f.csv")), bandwidth=BAND)
    JointSimulation(dragged, [ride], bandwidth=BAND)
    middle = torch.tensor([dragged.body.com], dtype=torch.float64).expand_as(ride.base.ang_vel)
    turning = torch.linalg.cross(ride.base.ang_vel, middle)
    velocity = quat_rotate_inverse(ride.base.attitude, ride.base.lin_vel) + turning
    torch.testing.assert_close((ride.wrench - plain.wrench)[:, 0, :2], -0.5 * velocity[:, :2], rtol=1e-6, atol=1e-9)


def test_friction_acts_against_the_motion_and_an_end_never_pulls() -> None:
    def row(*values: float) -> torch.Tensor:
        return torch.tensor([values], dtype=torch.float64)

    none, far = row(0.0, 0.0, 0.0), row(9.0, 9.0, 9.0)
    spring = Spring(stiffness=none, quadratic=none, damping=none, rest=none, preload=none)
    free = JointLimits(low=-far, high=far, stiffness=none, damping=none)
    slides = JointLaws(spring=spring, ends=free, friction=0.3 + none, slow=1e-3 + none)
    torch.testing.assert_close(slides.joint_effort(none, row(2.0, -2.0, 0.0)), row(-0.3, 0.3, 0.0), atol=1e-6, rtol=0)
    ends = JointLimits(low=-0.1 + none, high=0.1 + none, stiffness=4.0 + none, damping=1.0 + none)
    held = JointLaws(spring=spring, ends=ends, friction=none, slow=1e-3 + none)
    result = held.joint_effort(row(0.2, 0.2, -0.2), row(0.0, -5.0, 0.0))  # pushed back, left fast, pushed back
    torch.testing.assert_close(result, row(-0.4, 0.0, 0.4), atol=1e-12, rtol=0)


def test_what_cannot_be_found_so_is_refused_by_name(tmp_path: Path) -> None:
    table = flight([SAME] * 4, 4, seconds=3.2, noise=0.0)
    ride, plain = make_ride(table, tmp_path / "f.csv"), robot()
    assert_refused(DataError, "too short", fit_hidden_joints, plain, [ride], bandwidth=BAND)
    with pytest.raises(DataError, match=r"\[125.0, 250.0\] rows per second"):
        fit_hidden_joints(plain, [ride, make_ride(table[::2], tmp_path / "g.csv")], bandwidth=BAND)
    drive = DriveCfg(mode="effort", limit=1.0, command_range=(-1.0, 1.0))
    first = replace(plain.joints.layout[0], spring=None, drive=drive)
    driven = replace(plain, joints=replace(plain.joints, layout=(first, *plain.joints.layout[1:])))
    words = "without logged angles every joint must be passive and without creep, but arm0 has a drive"
    assert_refused(ConfigError, words, fit_hidden_joints, driven, [ride], bandwidth=BAND)
    with pytest.raises(ConfigError, match="this robot has no joints"):
        fit_hidden_joints(ROBOTS.get("base_quadrotor"), [ride], bandwidth=BAND)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 11])
def test_hidden_springs_are_named_and_found(seed: int, tmp_path: Path) -> None:
    """One flight of 10 s: stiffness to 3 %, damping to 10 %, rest to 10 mrad, friction to 15 %, and no other joint's
    name. Beside friction, which the fitted law lets creep, damping is off by up to 25 %."""
    (tmp_path / "robot.yaml").write_text(dump_yaml(robot()))
    without_angles(flight(HIDDEN, seed, seconds=11.0)).to_csv(tmp_path / "f.csv", index=False)
    out = tmp_path / "out"
    assert main(["identify", "joints", str(tmp_path / "robot.yaml"), str(tmp_path / "f.csv"), "--out", str(out)]) == 0
    result = json.loads((out / "result.json").read_text())
    joints = {joint["name"]: joint for joint in result["joints"]}
    assert joints["arm0"]["changed"] == ["stiffness"]
    assert set(joints["arm1"]["changed"]) == {"damping", "rest"}
    assert "friction" in joints["arm2"]["changed"]  # beside it stiffness may be off by 3 %, and is named as well
    assert joints["arm3"]["changed"] == []
    for number, hidden in enumerate(HIDDEN):
        rubs = hidden["friction"] > 0.0
        params = {name: value["value"] for name, value in joints[f"arm{number}"]["params"].items()}
        assert params["stiffness"] == pytest.approx(hidden["stiffness"], rel=0.03)
        assert params["damping"] == pytest.approx(hidden["damping"], rel=0.25 if rubs else 0.1)
        assert params["rest"] == pytest.approx(hidden["rest"], abs=0.01)
        assert params["friction"] == pytest.approx(hidden["friction"], rel=0.15, abs=5e-4)
    springs = [joint.spring for joint in load_robot(out / "robot.yaml").joints.layout]
    assert springs[3] == robot().joints.layout[3].spring
    assert springs[0].stiffness == pytest.approx(0.9, rel=0.03)


@pytest.mark.slow
def test_the_loop_names_joints_beside_effects(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(dump_yaml(robot()))
    paths = [tmp_path / f"f{seed}.csv" for seed in range(3)]
    for seed, path in enumerate(paths):
        flight(HIDDEN, seed, seconds=8.0).to_csv(path, index=False)
    declared, out = tmp_path / "robot.yaml", tmp_path / "out"
    verdict = close_loop(declared, paths[:2], paths[2:], out, effects=("rotor_drag",), joints=True)
    results = [(one.code, one.subject) for one in verdict.joint_findings]
    assert results[:2] == [("joint_found", "arm0"), ("joint_found", "arm1")]
    assert verdict.joint_findings[0].values["numbers"][0]["declared"] == 1.2
    told = json.loads((out / "verdict.json").read_text())
    assert [joint["name"] for joint in told["joints"] if joint["changed"]] == ["arm0", "arm1", "arm2"]
    springs = [joint.spring for joint in load_robot(out / "robot.yaml").joints.layout]
    assert springs[0].stiffness == pytest.approx(0.9, rel=0.01)
    codes = [one["code"] for one in told["findings"]]
    assert codes[0] == "joint_found"
    assert codes.count("joint_effort") == 4
    for report in ("report.md", "report.html"):
        page = (out / report).read_text()
        assert "Joints, fitted to the training flights" in page
        assert "the corrected robot is the declared one" not in page
    given = ["close-loop", "--robot", "base_quadrotor", "--train", str(paths[0]), "--test", str(paths[2])]
    assert main([*given, "--joints", "--out", str(tmp_path / "no")]) == 2
    assert not (tmp_path / "no").exists()
    with pytest.raises(ConfigError, match="leave the mapping out"):
        close_loop(declared, paths[:2], paths[2:], tmp_path / "no", mapping="nanobench_cf21", joints=True)


IN_WATER = {
    "link_buoyancy": {"force": 1.0, "left.x": 0.02},
    "link_added_mass": {"mx": 0.1, "my": 0.4, "right.jz": 1e-3},
    "link_drag": {"qx": 0.1, "lz": 0.2},
}


def test_free_joints_under_water_gave_no_effort() -> None:
    """By inverse dynamics of a motion that the step says; 3 m/s² and more times 0.1 kg are at stake."""
    robot = under_water(make_joints(), IN_WATER)
    model, state = make_model(robot, gravity=STANDARD_GRAVITY, num_envs=4)
    state, dt = draw_state(state), 1e-7
    after = fly(model, state, dt, 1)
    lin_acc = quat_rotate_inverse(state.attitude, (after.lin_vel - state.lin_vel) / dt)
    acc = torch.cat((lin_acc, (after.ang_vel - state.ang_vel) / dt, (after.joint_vel - state.joint_vel) / dt), dim=-1)
    efforts = joint_efforts(robot, tree_state(state), state.rotor_speed, acc)
    torch.testing.assert_close(efforts, torch.zeros_like(efforts), rtol=0.0, atol=1e-5)


def test_joints_that_nobody_logged_are_not_told_under_water() -> None:
    robot = replace(under_water(make_joints(), IN_WATER), effects_source="test")
    assert_refused(ConfigError, "link_added_mass .* Log them", body_motion, robot, None, bandwidth=15.0)
