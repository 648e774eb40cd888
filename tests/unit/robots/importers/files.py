"""Small files with the numbers of public vehicles, without their meshes, sensors and pictures.

- ``X2``: skydio_x2/x2.xml, ``CF2``: bitcraze_crazyflie_2/cf2.xml of MuJoCo Menagerie (Zakka et al., 2022);
- ``cf2x()``: gym_pybullet_drones/assets/cf2x.urdf of gym-pybullet-drones (Panerati et al., 2021, Learning to fly), MIT;
- ``X500``: models x500_base and x500 of PX4-gazebo-models; ``IRIS``: models/iris of PX4-SITL_gazebo-classic.
"""

import re
from collections.abc import Iterable
from pathlib import Path

X2 = """<mujoco><option density="1.225" viscosity="1.8e-5"/><compiler autolimits="true"/><worldbody>
<body name="x2" pos="0 0 0.1"><freejoint/>
<geom type="ellipsoid" size=".13 .13 .01" pos="-.14 -.18 .05" mass=".25"/>
<geom type="ellipsoid" size=".13 .13 .01" pos="-.14 .18 .05" mass=".25"/>
<geom type="ellipsoid" size=".13 .13 .01" pos=".14 .18 .08" mass=".25"/>
<geom type="ellipsoid" size=".13 .13 .01" pos=".14 -.18 .08" mass=".25"/>
<geom type="ellipsoid" size=".16 .04 .02" pos="0 0 .02" mass=".325" contype="0" conaffinity="0"/>
<geom type="box" size=".06 .027 .02" pos=".04 0 .02" mass="0"/>
<site name="thrust1" pos="-.14 -.18 .05"/><site name="thrust2" pos="-.14 .18 .05"/>
<site name="thrust3" pos=".14 .18 .08"/><site name="thrust4" pos=".14 -.18 .08"/></body></worldbody><actuator>
<motor name="thrust1" site="thrust1" ctrlrange="0 13" gear="0 0 1 0 0 -.0201"/>
<motor name="thrust2" site="thrust2" ctrlrange="0 13" gear="0 0 1 0 0 .0201"/>
<motor name="thrust3" site="thrust3" ctrlrange="0 13" gear="0 0 1 0 0 .0201"/>
<motor name="thrust4" site="thrust4" ctrlrange="0 13" gear="0 0 1 0 0 -.0201"/></actuator></mujoco>"""
"""Actuator 3 and 4 are front left and front right."""

CF2 = """<mujoco><compiler inertiafromgeom="false" autolimits="true"/><worldbody><body name="cf2" pos="0 0 0.1"><freejoint/>
<inertial pos="0 0 0" mass="0.027" diaginertia="2.3951e-5 2.3951e-5 3.2347e-5"/><site name="actuation"/>
<geom type="box" size=".03 .03 .01"/></body></worldbody><actuator>
<motor ctrlrange="0 0.35" gear="0 0 1 0 0 0" site="actuation" name="body_thrust"/>
<motor ctrlrange="-1e-5 1e-5" gear="0 0 0 -1 0 0" site="actuation" name="x_moment"/>
<motor ctrlrange="-1e-5 1e-5" gear="0 0 0 0 -1 0" site="actuation" name="y_moment"/>
<motor ctrlrange="-1e-5 1e-5" gear="0 0 0 0 0 -1" site="actuation" name="z_moment"/></actuator></mujoco>"""


def inertial(mass: float, *moments: float, pose: str = "0 0 0 0 0 0") -> str:
    tags = "".join(f"<i{a}>{m}</i{a}>" for a, m in zip(("xx", "yy", "zz"), moments, strict=True))
    return f"<inertial><pose>{pose}</pose><mass>{mass}</mass><inertia>{tags}</inertia></inertial>"


def motor(i: int, turning: str, numbers: dict[str, float], kind: str = "") -> str:
    tags = "".join(f"<{name}>{value}</{name}>" for name, value in numbers.items())
    return (
        f'<plugin name="m{i}" filename="libgazebo_motor_model.so"><jointName>rotor_{i}_joint</jointName>{kind}'
        f"<linkName>rotor_{i}</linkName><motorNumber>{i}</motorNumber><turningDirection>{turning}</turningDirection>{tags}</plugin>"
    )


PLACES = ("0.174 -0.174 0.06", "-0.174 0.174 0.06", "0.174 0.174 0.06", "-0.174 -0.174 0.06")
PX4_TURNING = ("ccw", "ccw", "cw", "cw")
X500_MOTOR = {
    "timeConstantUp": 0.0125, "timeConstantDown": 0.025, "maxRotVelocity": 1000.0, "motorConstant": 8.54858e-06,
    "momentConstant": 0.016, "rotorDragCoefficient": 8.06428e-05, "rollingMomentCoefficient": 1e-06,
}  # fmt: skip
IRIS_MOTOR = X500_MOTOR | {
    "maxRotVelocity": 1100.0, "motorConstant": 5.84e-06, "momentConstant": 0.06, "rotorDragCoefficient": 0.000175,
}  # fmt: skip


def x500(folder: Path) -> Path:
    """Write x500, which includes x500_base from the folder beside its own, and return its path."""
    blade = inertial(0.016076923076923075, 3.8464910483993325e-07, 2.6115851691700804e-05, 2.649858234714004e-05)
    links = "".join(f'<link name="rotor_{i}"><pose>{p} 0 0 0</pose>{blade}</link>' for i, p in enumerate(PLACES))
    joints = "".join(
        f'<joint name="rotor_{i}_joint" type="revolute"><parent>base_link</parent><child>rotor_{i}</child>'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
        for i in range(4)
    )
    base = inertial(2.0, 0.02166666666666667, 0.02166666666666667, 0.04000000000000001)
    size = "<geometry><box><size>0.35 0.35 0.05</size></box></geometry>"
    box = f'<collision name="c"><pose>0 0 .007 0 0 0</pose>{size}</collision>'
    body = f'<link name="base_link">{base}{box}</link>{links}{joints}'
    motors = "".join(motor(i, turning, X500_MOTOR) for i, turning in enumerate(PX4_TURNING))
    alone = f'<sdf version="1.9"><model name="x500_base"><pose>0 0 .24 0 0 0</pose>{body}</model></sdf>'
    included = '<include merge="true"><uri>model://x500_base</uri></include>'
    whole = f'<sdf version="1.9"><model name="x500">{included}{motors}</model></sdf>'
    return write(folder, x500_base=alone, x500=whole)


def iris(folder: Path) -> Path:
    """Write iris, whose rotors are placed by their joints, and whose GPS is a model within it."""
    places = ("0.13 -0.22 0.023", "-0.13 0.2 0.023", "0.13 0.22 0.023", "-0.13 -0.2 0.023")
    rotors = "".join(
        f'<joint name="rotor_{i}_joint" type="revolute"><pose relative_to="base_link">{p} 0 0 0</pose>'
        f'<parent>base_link</parent><child>rotor_{i}</child><axis><xyz>0 0 1</xyz></axis></joint><link name="rotor_{i}">'
        f'<pose relative_to="rotor_{i}_joint">0 0 0 0 0 0</pose>{inertial(0.005, 9.75e-07, 0.000273104, 0.000274004)}</link>'
        for i, p in enumerate(places)
    )
    gps = f'<model name="gps0"><link name="link">{inertial(0.01, 2.1733e-06, 2.1733e-06, 1.8e-07)}</link></model>'
    imu = f'<link name="/imu_link">{inertial(0.015, 1e-05, 1e-05, 1e-05)}</link>'
    motors = "".join(motor(i, turning, IRIS_MOTOR) for i, turning in enumerate(PX4_TURNING))
    base = f'<link name="base_link">{inertial(1.5, 0.029125, 0.029125, 0.055225)}</link>'
    return write(folder, iris=f'<sdf version="1.7"><model name="iris">{base}{imu}{rotors}{motors}{gps}</model></sdf>')


def write(folder: Path, **models: str) -> Path:
    """Write models into folders of their own, and return the path of the last one."""
    path = folder
    for name, text in models.items():
        path = folder / name / "model.sdf"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return path


def cf2x() -> str:
    """Return a Crazyflie in an X: a base, four propellers without mass that stand where their inertial frames do, and a link
    that marks the centre of mass."""
    empty = '<mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>'
    own = '<mass value="0.027"/><inertia ixx="1.4e-5" ixy="0" ixz="0" iyy="1.4e-5" iyz="0" izz="2.17e-5"/>'
    shape = '<collision><geometry><cylinder radius="0.06" length="0.025"/></geometry></collision>'
    places = {f"prop{i}": xy for i, xy in enumerate(("0.028 0.028", "-0.028 0.028", "-0.028 -0.028", "0.028 -0.028"))}
    massless = "".join(
        f'<link name="{name}_link"><inertial><origin xyz="{xy} 0"/>{empty}</inertial></link><joint name="{name}_joint" '
        f'type="fixed"><parent link="base_link"/><child link="{name}_link"/></joint>'
        for name, xy in {**places, "center_of_mass": "0 0"}.items()
    )
    numbers = 'arm="0.0397" kf="3.16e-10" km="7.94e-12" thrust2weight="2.25" drag_coeff="1" gnd_eff_coeff="1"'
    base = f'<link name="base_link"><inertial>{own}</inertial>{shape}</link>'
    return f'<robot name="cf2"><properties {numbers}/>{base}{massless}</robot>'


def check_named_once(out: Path, said: str, names: Iterable[str]) -> None:
    """Check that each of these names stands in one line of what was said, and each line in the head of the robot file."""
    lines = said.splitlines()
    for name in names:
        assert sum(re.search(rf"(?<!\w){re.escape(name)}(?!\w)", line) is not None for line in lines) == 1, name
    assert set(lines) <= {line.removeprefix("# ") for line in out.read_text(encoding="utf-8").splitlines()}
