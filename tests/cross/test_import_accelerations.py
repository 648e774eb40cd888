"""Random vehicle files: what each rotor does to the body against MuJoCo (MJCF), or against the file's own numbers (SDF,
URDF). Accelerations per newton come from the composite body and the allocation of the imported robot. The other side is
an engine that shares no code with ours, or sums about the origin of the root link with SciPy's rotations."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.control.allocation import allocation_matrix
from aerial_gym.physics import vehicle_from_config
from aerial_gym.robots.importers import RotorHints, read_robot

G = 9.81
SEEDS = range(24)


def number_text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def per_newton(robot: RobotCfg) -> np.ndarray:
    """Return accelerations [m/s²] of the body origin and [rad/s²], body axes, for 1 N of each rotor, (6, R)."""
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    force, torque = np.split(allocation_matrix(vehicle, G)[0].numpy(), 2)
    return at_origin(robot, force, torque)


def at_origin(robot: RobotCfg, force: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Return accelerations of the body origin and about it for forces and torques at the centre of mass, (3, ...) each."""
    turning = np.linalg.solve(np.array(robot.body.inertia), torque)
    linear = force / robot.body.mass + np.cross(turning.T, -np.array(robot.body.com)).T
    return np.concatenate([linear, turning])


def random_inertial(rng: np.random.Generator, scale: float) -> str:
    """Return an <inertial> that a body can have: moments of three squares, two at a time."""
    squares = scale * rng.uniform(1e-3, 4e-3, 3)
    moments = squares.sum() - squares
    turn = Rotation.random(random_state=int(rng.integers(1 << 30))).as_quat(scalar_first=True)
    return (
        f'<inertial pos="{number_text(rng.uniform(-0.05, 0.05, 3))}" mass="{scale * rng.uniform(0.5, 1.5):.9g}" '
        f'quat="{number_text(turn)}" diaginertia="{number_text(moments)}"/>'
    )


def random_site(rng: np.random.Generator, name: str, angle: float) -> str:
    turned = (
        "",
        f'euler="{number_text(angle * rng.uniform(-0.5, 0.5, 3))}"',
        f'zaxis="{number_text(rng.uniform(-0.5, 0.5, 2))} 1"',
        f'quat="{number_text(Rotation.random(random_state=int(rng.integers(1 << 30))).as_quat())}"',
    )
    return f'<site name="{name}" pos="{number_text(rng.uniform(-0.2, 0.2, 3))}" {rng.choice(turned)}/>'


def random_actuator(rng: np.random.Generator, name: str) -> str:
    """Return an actuator with all six gears; its force is bounded by its control, its activation or its force range."""
    gear = f'gear="{number_text([*rng.uniform(-0.4, 0.4, 2), rng.uniform(0.5, 2.0), *rng.uniform(-0.05, 0.05, 3)])}"'
    low, high = rng.choice([0.0, -2.0, 0.5]), rng.uniform(4.0, 8.0)
    limits = f'ctrlrange="{low} {high}"'
    clipped = f'forcerange="{rng.uniform(-1.0, 1.0):.6g} {rng.uniform(2.0, 3.0):.6g}"' if rng.random() < 0.5 else ""
    free = f'{gear} site="{name}" name="{name}"'
    both = f"{free} {clipped}"
    lagged = f'dyntype="{rng.choice(["filter", "filterexact"])}" dynprm="{rng.uniform(0.02, 0.1):.6g}"'
    kinds = (
        f"<motor {both} {limits}/>", f'<general {both} {limits} gainprm="{rng.uniform(0.3, 2.0):.6g}"/>',
        f'<general {free} {limits} gainprm="-1.5" biastype="affine" biasprm="{rng.uniform(-2.0, 2.0):.6g} -3 -0.1"/>',
        f'<general {free} ctrlrange="{-high} {-1.0}" {lagged}/>',
        f'<position {both} {limits} kp="{rng.uniform(0.3, 2.0):.6g}" kv="0.1"/>',
        f"<general {both} {limits} {lagged}/>", f'<general {both} {limits} {lagged} actrange="0.2 3"/>',
        f'<general {both} ctrlrange="-50 50" dyntype="integrator" actrange="0.1 {high}"/>',
        f'<general {free} forcerange="-1 4"/>', f'<general site="{name}" name="{name}" class="rotor"/>',
    )  # fmt: skip
    return str(rng.choice(kinds))


FREE = '<joint type="free" armature="0.3"/>'


def random_mjcf(rng: np.random.Generator) -> str:
    """Return a vehicle of welded bodies whose masses, frames and actuators are drawn, with settings of the compiler."""
    degrees = rng.random() < 0.5
    angle = 180.0 / np.pi if degrees else 1.0
    settings = [
        f'angle="{"degree" if degrees else "radian"}"',
        f'eulerseq="{rng.choice(["xyz", "zyx", "XYZ", "ZYX", "xYz"])}"',
        rng.choice(["", 'settotalmass="2.5"', 'balanceinertia="true"', 'boundmass="0.3" boundinertia="0.001"']),
        rng.choice(["", 'inertiafromgeom="true"', 'inertiafromgeom="false"']),
    ]
    count = int(rng.integers(4, 8))
    sites = [random_site(rng, f"s{n}", angle) for n in range(count)]
    bodies = ""
    for n in range(2):
        own = random_inertial(rng, 0.2)
        geom = (
            f'<geom type="box" size="{number_text(rng.uniform(0.02, 0.06, 3))}" density="{rng.uniform(100, 900):.6g}"/>'
        )
        place = f'pos="{number_text(rng.uniform(-0.2, 0.2, 3))}" euler="{number_text(angle * rng.uniform(-1, 1, 3))}"'
        inner, sites = "".join(sites[:1]), sites[1:]
        bodies += f'<body name="pod{n}" {place} gravcomp="{rng.choice([0, 1, 0.5])}">{own}{geom}{inner}'
    closing = "</body>" * 2 if rng.random() < 0.5 else ""
    bodies = (
        bodies + closing if closing else bodies.replace('<body name="pod1"', '</body><body name="pod1"') + "</body>"
    )
    hull = (
        f'<body name="hull" pos="{number_text(rng.uniform(-1, 1, 3))}" euler="{number_text(angle * rng.uniform(-3, 3, 3))}">'
        f"{rng.choice(['<freejoint/>', FREE])}"
        f'{random_inertial(rng, 1.0)}<geom type="ellipsoid" size="0.1 0.08 0.05" density="700"/>{"".join(sites)}{bodies}</body>'
    )
    default = (
        '<default><default class="rotor"><general gear="0.1 0 1.2 0.01 0 -0.02" ctrllimited="true" ctrlrange="0 5" '
        'gainprm="0.8"/></default></default>'
    )
    actuators = "".join(random_actuator(rng, f"s{n}") for n in range(count))
    return (
        f'<mujoco><compiler autolimits="true" {" ".join(settings)}/><option><flag contact="disable"/></option>{default}'
        f"<worldbody>{hull}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )


def extremes(model: Any, mujoco: Any, i: int) -> tuple[float, float]:
    """Return the lowest and the highest that an actuator's force can follow: its control, or its activation."""
    if model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return tuple(model.actuator_actrange[i])
    low, high = model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] else (-1e3, 1e3)
    if model.actuator_dyntype[i] != mujoco.mjtDyn.mjDYN_NONE and model.actuator_actlimited[i]:
        low, high = np.clip((low, high), *model.actuator_actrange[i])
    return low, high


def accelerations(mujoco: Any, model: Any, values: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return accelerations of the free body at rest (6,) and scalar forces of the actuators, for controls or activations."""
    data = mujoco.MjData(model)
    for i, value in enumerate(values):
        if model.actuator_actadr[i] >= 0:
            data.act[model.actuator_actadr[i]] = value
        else:
            data.ctrl[i] = value
    mujoco.mj_forward(model, data)
    return data.qacc[:6].copy(), data.actuator_force.copy()


@pytest.mark.parametrize("seed", SEEDS)
def test_rotors_of_an_mjcf_accelerate_it_as_in_mujoco(seed: int, tmp_path: Path) -> None:
    """From the lowest to the highest force of each actuator, and all at their highest under gravity: 1e-9 of the largest."""
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(random_mjcf(np.random.default_rng(seed)))
    robot = read_robot(path, RotorHints(lag=0.05), gravity=G).robot
    model = mujoco.MjModel.from_xml_path(str(path))
    mass = (
        model.body_subtreemass[model.body("hull").id] + model.dof_armature[0]
    )  # which accelerates, and weighs nothing
    assert robot.body.mass == pytest.approx(mass, rel=1e-9)
    ends = [extremes(model, mujoco, i) for i in range(model.nu)]
    low, lowest = accelerations(mujoco, model, [a for a, _ in ends])
    turn = Rotation.from_quat(model.qpos0[3:7], scalar_first=True)
    actual = per_newton(robot)
    sizes = np.linalg.norm(model.actuator_gear[:, :3], axis=1)
    total = np.zeros(6)
    for i, rotor in enumerate(robot.rotor_types):
        high, forces = accelerations(mujoco, model, [b if k == i else a for k, (a, b) in enumerate(ends)])
        thrusts = sizes[i] * np.array((lowest[i], forces[i]))
        expected = sorted(thrusts if max(thrusts) > 0.0 else -thrusts)
        np.testing.assert_allclose(rotor.thrust_range, expected, rtol=1e-9, atol=1e-12)
        sign = 1.0 if np.isclose(max(thrusts), rotor.thrust_range[1]) else -1.0
        change = np.concatenate([turn.apply((high - low)[:3], inverse=True), (high - low)[3:]])
        np.testing.assert_allclose(
            sign * np.ptp(thrusts) * np.sign(thrusts[1] - thrusts[0]) * actual[:, i],
            change,
            atol=1e-9 * np.abs(change).max(),
        )
        total += sign * thrusts[0] * actual[:, i]
    up = turn.apply((0.0, 0.0, 1.0), inverse=True)
    lift = robot.effects.get("buoyancy", {"force": 0.0, "x": 0.0, "y": 0.0, "z": 0.0})
    place = np.array([lift["x"], lift["y"], lift["z"]]) - robot.body.com
    total += at_origin(robot, lift["force"] * up, np.cross(place, lift["force"] * up))
    total[:3] -= G * up
    reference = np.concatenate([turn.apply(low[:3], inverse=True), low[3:]])
    np.testing.assert_allclose(total, reference, atol=1e-9 * np.abs(reference).max())


@dataclass
class RandomBody:
    """A rigid part: what a file says of it, kept as numbers."""

    turn: Rotation  # Of its own axes in the world's
    place: np.ndarray  # Of its centre of mass [m], world

    mass: float
    inertia: np.ndarray  # About that centre, own axes [kg m²]


@dataclass
class RandomVehicle:
    """What a random file describes, as its writer knows it."""

    bodies: list[RandomBody] = field(default_factory=list)
    thrusts: list[tuple[np.ndarray, np.ndarray, float]] = field(default_factory=list)
    """Where each rotor pushes [m], along what, and its torque per thrust with a sign, world."""

    root: tuple[Rotation, np.ndarray] = (Rotation.identity(), np.zeros(3))

    def per_newton(self) -> np.ndarray:
        """Return accelerations of the root's origin and about it, its axes, for 1 N of each rotor, (6, R)."""
        turn, origin = self.root
        places = [body.place - origin for body in self.bodies]
        mass = sum(body.mass for body in self.bodies)
        centre = sum(body.mass * place for body, place in zip(self.bodies, places, strict=True)) / mass
        about = np.zeros((3, 3))
        for body, place in zip(self.bodies, places, strict=True):
            own = body.turn.as_matrix()
            about += own @ body.inertia @ own.T + body.mass * (place @ place * np.eye(3) - np.outer(place, place))
        about -= mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
        columns = []
        for place, axis, ratio in self.thrusts:
            turning = np.linalg.solve(about, np.cross(place - origin - centre, axis) + ratio * axis)
            linear = axis / mass + np.cross(turning, -centre)
            columns.append([*turn.apply(linear, inverse=True), *turn.apply(turning, inverse=True)])
        return np.array(columns).T


class SdfWriter:
    """A random SDF model, and what it describes."""

    def __init__(self, rng: np.random.Generator, folder: Path) -> None:
        self.rng, self.folder, self.vehicle, self.text = rng, folder, RandomVehicle(), ""
        self.frames: dict[str, tuple[Rotation, np.ndarray]] = {"": (Rotation.identity(), np.zeros(3))}

    def pose(self, base: str, scale: float = 0.3, attributes: str = "") -> tuple[str, tuple[Rotation, np.ndarray]]:
        """Return a random <pose> in one of three notations, and the frame that it means."""
        rng = self.rng
        place, kind = rng.uniform(-scale, scale, 3), rng.integers(3)
        turn = Rotation.from_euler("xyz", rng.uniform(-1.0, 1.0, 3))
        angles = turn.as_euler("xyz")
        if kind == 0:
            values, attributes = [*place, *angles], attributes
        elif kind == 1:
            values, attributes = [*place, *np.degrees(angles)], f'{attributes} degrees="true"'
        else:
            values, attributes = [*place, *turn.as_quat()], f'{attributes} rotation_format="quat_xyzw"'
        at, origin = self.frames[base]
        return f"<pose {attributes}>{number_text(values)}</pose>", (at * turn, origin + at.apply(place))

    def weight(self, frame: tuple[Rotation, np.ndarray]) -> str:
        """Return the inertial that a link declares, and keep its meaning."""
        rng, kind = self.rng, self.rng.integers(6)
        at, origin = frame
        mass, squares = rng.uniform(0.2, 1.0), rng.uniform(1e-3, 4e-3, 3)
        full = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
        inertia = full @ np.diag(squares.sum() - squares) @ full.T
        tags = "".join(
            f"<i{a}{b}>{inertia['xyz'.index(a), 'xyz'.index(b)]:.15g}</i{a}{b}>"
            for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        if kind == 0:  # nothing: 1 kg and 1 kg m²
            self.vehicle.bodies.append(RandomBody(at, origin, 1.0, np.eye(3)))
            return ""
        if kind == 1:  # mass without inertia
            self.vehicle.bodies.append(RandomBody(at, origin, mass, np.eye(3)))
            return f"<inertial><mass>{mass:.15g}</mass></inertial>"
        if kind == 2:  # two of three moments
            self.vehicle.bodies.append(RandomBody(at, origin, 1.0, np.diag([0.7, 1.0, 0.9])))
            return "<inertial><inertia><ixx>0.7</ixx><izz>0.9</izz></inertia></inertial>"
        if kind == 3:
            self.frames["own"] = frame
            text, (turn, place) = self.pose("own", 0.1)
            self.vehicle.bodies.append(RandomBody(turn, place, mass, inertia))
            return f"<inertial>{text}<mass>{mass:.15g}</mass><inertia>{tags}</inertia></inertial>"
        return self.auto(frame, scaled=kind == 5)

    def auto(self, frame: tuple[Rotation, np.ndarray], *, scaled: bool) -> str:
        """Return an automatic inertial of two boxes, one of them a mesh in millimetres, and keep what that means."""
        rng, shapes, boxes = self.rng, "", []
        self.frames["own"] = frame
        for n in range(2):
            text, (turn, place) = self.pose("own", 0.1)
            edges, density = rng.uniform(0.03, 0.1, 3), (rng.uniform(100, 900) if n else None)
            told = "" if density is None else f"<density>{density:.15g}</density>"
            shape = f"<box><size>{number_text(edges)}</size></box>"
            if rng.random() < 0.5:
                name = f"mesh{len(list(self.folder.iterdir()))}.stl"
                trimesh.creation.box(1000.0 * edges / (1.0, 2.0, 4.0)).export(self.folder / name)
                shape = f"<mesh><uri>{name}</uri><scale>0.001 0.002 0.004</scale></mesh>"
            shapes += f'<collision name="c{n}">{text}{told}<geometry>{shape}</geometry></collision>'
            mass = (density or 400.0) * edges.prod()
            boxes.append(RandomBody(turn, place, mass, mass / 12.0 * np.diag((edges @ edges) - edges**2)))
        given = ""
        if scaled:
            share = 0.8 / sum(box.mass for box in boxes)
            boxes = [RandomBody(box.turn, box.place, share * box.mass, share * box.inertia) for box in boxes]
            given = "<mass>0.8</mass>"
        self.vehicle.bodies += boxes
        return f'<inertial auto="true"><density>400</density>{given}</inertial>{shapes}'

    def link(self, name: str, base: str = "", attributes: str = "", within: str = "") -> str:
        """Return a link in a frame, and keep it under its scoped name."""
        text, frame = self.pose(base, attributes=attributes)
        self.frames[within + name] = frame
        before = len(self.vehicle.bodies)
        own = self.weight(frame)
        parts = self.vehicle.bodies[before:]
        self.hub = sum(part.mass * part.place for part in parts) / sum(part.mass for part in parts)
        return f'<link name="{name}">{text}{own}</link>'

    def rotor(self, n: int) -> str:
        """Return a rotor, placed in one of four ways, and its motor; keep where and how it pushes."""
        rng, kind, name = self.rng, self.rng.integers(4), f"rotor_{n}"
        axis = rng.choice(["0 0 1", "0 0 -1", "0.1 0 1"])
        joint = (
            f'<joint name="{name}_joint" type="revolute"><parent>base</parent><child>{{}}</child>{{}}'
            f"<axis><xyz>{axis}</xyz></axis></joint>"
        )
        motor = self.motor(name, n)
        if kind == 0:
            text = self.link(name) + joint.format(name, "") + motor
        elif kind == 1:  # a frame on another link
            pose, self.frames[f"f{n}"] = self.pose("base")
            text = f'<frame name="f{n}" attached_to="base">{pose}</frame>'
            text += self.link(name, f"f{n}", f'relative_to="f{n}"') + joint.format(name, "") + motor
        elif kind == 2:  # a joint that is placed, and a link on it
            pose, self.frames[f"{name}_joint"] = self.pose("base", attributes='relative_to="base"')
            text = joint.format(name, pose) + self.link(name, f"{name}_joint", f'relative_to="{name}_joint"') + motor
        else:  # a model within, with a motor of its own
            pose, self.frames[f"m{n}"] = self.pose("")
            inner = self.link(name, f"m{n}", within=f"m{n}::") + f'<link name="hub">{self.small(f"m{n}")}</link>'
            spun = joint.replace("<parent>base", "<parent>hub").format(name, "")
            fixed = f'<joint name="h{n}" type="fixed"><parent>base</parent><child>m{n}::hub</child></joint>'
            name = f"m{n}::{name}"
            hub = self.hub
            text = f'<model name="m{n}">{pose}{inner}{spun}{motor}</model>{fixed}'
            self.hub = hub
        turn, _ = self.frames[name]
        self.vehicle.thrusts.append((self.hub, turn.apply((0.0, 0.0, 1.0)), -self.spins[n] * self.ratio))
        return text

    def small(self, base: str) -> str:
        turn, place = self.frames[base]
        self.vehicle.bodies.append(RandomBody(turn, place, 0.05, 1e-5 * np.eye(3)))
        return "<inertial><mass>0.05</mass><inertia><ixx>1e-5</ixx><iyy>1e-5</iyy><izz>1e-5</izz></inertia></inertial>"

    def motor(self, link: str, n: int) -> str:
        return (
            f'<plugin name="gz::sim::systems::MulticopterMotorModel" filename="gz-sim-multicopter-motor-model-system">'
            f"<jointName>{link}_joint</jointName><linkName>{link}</linkName><motorNumber>{n}</motorNumber><turningDirection>"
            f"{'ccw' if self.spins[n] > 0 else 'cw'}</turningDirection><momentConstant>{self.ratio}</momentConstant></plugin>"
        )

    def write(self) -> Path:
        """Write the model and return its path."""
        count = int(self.rng.integers(4, 7))
        self.spins, self.ratio = self.rng.choice([-1, 1], count), 0.03
        text = self.link("base")
        self.vehicle.root = self.frames["base"]
        text += "".join(self.rotor(n) for n in range(count))
        path = self.folder / "model.sdf"
        path.write_text(f'<sdf version="1.11"><model name="m"><pose>1 2 3 0.1 0.2 0.3</pose>{text}</model></sdf>')
        return path


@pytest.mark.parametrize("seed", SEEDS)
def test_rotors_of_an_sdf_accelerate_it_by_its_own_numbers(seed: int, tmp_path: Path) -> None:
    """Links with full, partial, absent and automatic inertials in nested frames; rotors push along z of their links."""
    writer = SdfWriter(np.random.default_rng(seed), tmp_path)
    robot = read_robot(writer.write(), RotorHints(accept_losses=True)).robot
    single = 1e-6  # STL files hold coordinates of single precision, 6e-8
    assert robot.body.mass == pytest.approx(sum(body.mass for body in writer.vehicle.bodies), rel=single)
    expected = writer.vehicle.per_newton()
    np.testing.assert_allclose(per_newton(robot), expected, atol=single * np.abs(expected).max())


def random_urdf(rng: np.random.Generator, vehicle: RandomVehicle) -> str:
    """Return a URDF with motors for Gazebo, whose blades are links fixed to those of the rotors; fill in what it describes."""
    frames, text = {"base": (Rotation.identity(), np.zeros(3))}, ""

    def link(name: str) -> tuple[str, RandomBody]:
        at, origin = frames[name]
        place, angles = rng.uniform(-0.05, 0.05, 3), rng.uniform(-1.0, 1.0, 3)
        mass, squares = rng.uniform(0.1, 1.0), rng.uniform(1e-3, 4e-3, 3)
        inertia = np.diag(squares.sum() - squares)
        body = RandomBody(at * Rotation.from_euler("xyz", angles), origin + at.apply(place), mass, inertia)
        moments = " ".join(f'i{a}{a}="{inertia[i, i]:.15g}"' for i, a in enumerate("xyz"))
        return (
            f'<link name="{name}"><inertial><origin xyz="{number_text(place)}" rpy="{number_text(angles)}"/>'
            f'<mass value="{mass:.15g}"/>'
            f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
        ), body

    def joint(child: str, parent: str, kind: str) -> str:
        at, origin = frames[parent]
        place, angles = rng.uniform(-0.3, 0.3, 3), rng.uniform(-1.0, 1.0, 3)
        frames[child] = (at * Rotation.from_euler("xyz", angles), origin + at.apply(place))
        axis = f'<axis xyz="{rng.choice(["0 0 1", "0 0 -1"])}"/>'
        return (
            f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{number_text(place)}" rpy="{number_text(angles)}"/>{axis}</joint>'
        )

    for name, parent, kind in [
        ("arm", "base", "fixed"),
        *((f"rotor_{n}", ("base", "arm")[n % 2], "continuous") for n in range(5)),
        ("blade", "rotor_0", "fixed"),
        ("tip", "blade", "fixed"),
    ]:
        text += joint(name, parent, kind)
    parts = {name: link(name) for name in frames}
    vehicle.bodies += [body for _, body in parts.values()]
    for n in range(5):
        group = [parts[name][1] for name in (("rotor_0", "blade", "tip") if n == 0 else (f"rotor_{n}",))]
        hub = sum(part.mass * part.place for part in group) / sum(part.mass for part in group)
        spin = int(rng.choice([-1, 1]))
        vehicle.thrusts.append((hub, frames[f"rotor_{n}"][0].apply((0.0, 0.0, 1.0)), -0.05 * spin))
        text += (
            f'<gazebo><plugin name="p{n}" filename="librotors_gazebo_motor_model.so"><jointName>rotor_{n}_joint</jointName>'
            f"<linkName>rotor_{n}</linkName><motorNumber>{n}</motorNumber><momentConstant>0.05</momentConstant>"
            f"<turningDirection>{'ccw' if spin > 0 else 'cw'}</turningDirection></plugin></gazebo>"
        )
    return f'<robot name="r">{"".join(part for part, _ in parts.values())}{text}</robot>'


@pytest.mark.parametrize("seed", SEEDS)
def test_rotors_of_a_urdf_accelerate_it_by_its_own_numbers(seed: int, tmp_path: Path) -> None:
    """Links turned on turned joints; Gazebo joins fixed links before the thrust acts at their common centre of mass."""
    pytest.importorskip("yourdfpy")
    vehicle, path = RandomVehicle(), tmp_path / "robot.urdf"
    path.write_text(random_urdf(np.random.default_rng(seed), vehicle))
    expected = vehicle.per_newton()
    actual = per_newton(read_robot(path).robot)
    np.testing.assert_allclose(actual, expected, atol=1e-9 * np.abs(expected).max())
