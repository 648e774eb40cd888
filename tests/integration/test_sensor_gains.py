"""Wrong gains of sensors in flights of the declared vehicle: no effect on the vehicle is named for them."""

import json
from collections.abc import Collection
from pathlib import Path

import pandas as pd
import pytest

from aerial_gym.sim2real import close_loop
from benchmarks.undeclared import make_case
from benchmarks.undeclared.cases import CaseFiles
from tests.repetitions import rare_values

GYRO, MOTION = [f"omega_{axis}" for axis in "xyz"], [f"{kind}_{axis}" for kind in "pv" for axis in "xyz"]
ROTORS, COMMANDS = ([f"{kind}_{rotor}" for rotor in (1, 2, 3, 4)] for kind in ("rotor", "cmd"))
CASES = {
    "gyro": (GYRO, 1.05, (), None),
    "gyro far off": (GYRO, 1.1, (), None),
    "one axis of the gyro": (["omega_z"], 0.9, (), None),
    "position and velocity": (MOTION, 1.1, (), None),
    "accelerometer": (["acc_x", "acc_y", "acc_z"], 1.1, (), None),
    "tachometer": (["rotor_4"], 1.04, (), ("explained", {"tachometer_scale"})),
    "tachometer without commands": (["rotor_4"], 1.04, COMMANDS, ("ambiguous", {"weak_motor", "tachometer_scale"})),
    "command of one rotor": (["cmd_2"], 1.05, (), ("explained", {"motor_gain"})),
    "all rotor speeds": (ROTORS, 1.04, (), ("explained", {"rotor_speed_scale"})),
}
"""Columns, factor on them, lost columns, and the expected verdict with its candidates; none: no effect is named."""
OFTEN = ("tachometer without commands",)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> CaseFiles:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)
        flights = {"num_train": 3, "num_test": 1, "duration_s": 6.0, "rate_hz": 200}
        return make_case(tmp_path_factory.mktemp("case"), effects={}, seed=9105, nuisance=True, **flights)


@pytest.mark.parametrize("name", rare_values(CASES, [name for name in CASES if name not in OFTEN]))
def test_a_gain_of_a_sensor_is_no_effect_on_the_vehicle(name: str, files: CaseFiles, tmp_path: Path) -> None:
    columns, factor, lost, expected = CASES[name]
    train, test = (scale_columns(part, columns, factor, lost, tmp_path) for part in (files.train, files.test))
    close_loop(files.robot, train, test, tmp_path / "out")
    verdict = json.loads((tmp_path / "out" / "verdict.json").read_text(encoding="utf-8"))
    if expected:
        assert (verdict["verdict"], set(verdict["candidates"])) == expected
    else:
        assert verdict["verdict"] in ("none", "not shown")
        assert not verdict["effects"]


def scale_columns(
    logs: Collection[Path], columns: list[str], factor: float, lost: Collection[str], folder: Path
) -> list[Path]:
    """Return copies of logs with columns times a factor, and without the lost ones."""
    for log in logs:
        table = pd.read_csv(log).drop(columns=list(lost))
        table[columns] *= factor
        table.to_csv(folder / log.name, index=False)
    return [folder / log.name for log in logs]
