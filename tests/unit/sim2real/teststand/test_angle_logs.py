"""Joints from flights: a plant of MuJoCo, written here as XML, that shares no code with the engine that judges it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.cli.main import main
from aerial_gym.config.joint import DriveCfg, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import BodyCfg, CollisionCfg, MountCfg, MountsCfg, RobotCfg, RotorCfg, load_robot
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording import text

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
