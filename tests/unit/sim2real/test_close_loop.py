"""The whole loop on exact flights with noise: a smoke test, no proof; ``tests/integration/test_loop_on_plant.py`` has an
independent plant, ``tests/measured/test_public_flights.py`` real flights."""

import errno
import json
import shutil
from contextlib import redirect_stdout
from dataclasses import replace
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerial_gym import SimBuilder
from aerial_gym import close_loop as loop_function
from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml, load
from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError, StorageError
from aerial_gym.interop import one_thread
from aerial_gym.physics.model import check_effects
from aerial_gym.sim2real import close_loop, judge_flights, replay
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.judge.analysis import LoopResult
from aerial_gym.sim2real.judge.answer import all_findings
from aerial_gym.sim2real.judge.verdict import MOST_CONFIDENT
from aerial_gym.sim2real.logs.flights import load_train_and_test
from aerial_gym.sim2real.report.run_folder import atomic_run_folder
from aerial_gym.sim2real.wording import text
from tests.refusals import assert_refused
from tests.unit.sim2real.flat_flights import ROBOT, flight, verdict_of_command, write

DRAG = 0.25
SECTIONS = ("flights", "effects", "evidence", "rivals", "before-after", "next", "rest", "data")
TABLES = {"residuals.csv", "profiles.csv", "evidence.csv"}
OUTPUTS = {"verdict.json", "robot.yaml", "report.html", "report.md", "run.json"} | TABLES


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flights")
    (path / "robot.yaml").write_text(dump_yaml(ROBOT))
    for seed in range(4):
        write(flight(20 + seed, drag=DRAG, noise=1.0, seconds=8.0, rate=100.0), path / f"f{seed}.csv")
    return path


@pytest.fixture(scope="module")
def call(folder: Path) -> list[str]:
    train, test = [str(folder / f"f{n}.csv") for n in range(3)], str(folder / "f3.csv")
    return ["close-loop", "--robot", str(folder / "robot.yaml"), "--train", *train, "--test", test]


@pytest.fixture(scope="module")
def run(folder: Path, call: list[str]) -> tuple[Path, str]:
    """Return the folder of results of the command, and what it printed. One more training flight cannot be used, and
    the folder of the flights is gone as soon as they are read."""
    out, known, printed = folder / "result", folder.parent / "tolerances.yaml", StringIO()
    opened: list[str] = []
    known.write_text("mass: 0.002\n")
    gone = Path(shutil.copytree(folder, folder.parent / "gone"))
    write(pd.read_csv(gone / "f0.csv").assign(omega_y=0.0), gone / "f9.csv")
    arguments = [text.replace(str(folder), str(gone)) for text in call]
    arguments[-2:-2] = [str(gone / "f9.csv")]

    def without_files(*args: Any, **options: Any) -> LoopResult:
        shutil.rmtree(gone)
        return judge_flights(*args, **options)

    with redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_module("aerial_gym.sim2real.loop"), "judge_flights", without_files)
        patch.setattr("webbrowser.open", lambda address: not opened.append(address))
        assert main([*arguments, "--out", str(out), "--ranges", "--tolerances", str(known), "--open"]) == 0
    assert opened == [(out / "report.html").as_uri()]
    assert not gone.exists()
    return out, printed.getvalue()


@pytest.fixture(scope="module")
def result(run: tuple[Path, str]) -> Path:
    return run[0]


def test_the_verdict_names_the_hidden_drag(result: Path) -> None:
    verdict = json.loads((result / "verdict.json").read_text())
    assert verdict["verdict"] == "explained"
    assert [effect["name"] for effect in verdict["effects"]] == ["rotor_drag"]
    (effect,) = verdict["effects"]
    for axis in ("dx", "dy"):
        low, high = effect["interval"][axis]
        assert low < DRAG < high
    assert 0.99 < effect["confidence"] == min(verdict["inclusion"]["rotor_drag"], MOST_CONFIDENT) < 1.0
    assert effect["material"] is True
    untold = {"motor_time_constant", "motor_asymmetry", "actuation_delay", "battery_sag", "thrust_voltage"}
    untold |= {"ground_effect", "ceiling_effect", "downwash", "command_curve", "motor_gain"}
    # Creep is left open: thrusts that hardly change show the compliance of slow arms to just its scale, 0.996 of it.
    assert set(verdict["not_testable"]) - {"joint_creep"} == untold
    statements = {(one["code"], one["subject"]): one["values"] for one in verdict["findings"]}
    assert statements["logs_lack", "ceiling_effect"]["need"] == "ceiling_height"
    assert verdict["structure"]["kind"] == "none"
    assert verdict["whiteness"]["specific_force.x"]["white"] is True
    assert effect["without_it"]["octaves"][0] > 0.9  # a path of a few tenths of a hertz
    assert effect["without_it"]["solid_below_hz"] in (1.25, 2.5, 5.0)
    before, after = verdict["before"], verdict["after"]
    for axis in "xy":
        assert after["specific_force"][axis]["rms"] < 0.3 * before["specific_force"][axis]["rms"]
        low, high = after["specific_force"][axis]["interval"]
        assert low < after["specific_force"][axis]["rms"] < high
    for horizon in ("0.1", "0.5", "1", "2"):
        assert set(after["rollout"][horizon]) == {"position", "velocity", "attitude"}
        assert after["specific_force"][axis]["gap_closed"] > 0.95
    became = verdict["test_flights"]
    assert became["specific_force.x"]["state"] == became["specific_force.y"]["state"] == "better"
    assert became["free.velocity.1"]["rises"] < -0.5  # two groups of windows: no more than the size is shown
    assert became["specific_force.x"]["interval"][1] < -0.5
    (gain,) = (values["errors"] for (code, _), values in statements.items() if code == "errors_fall")
    assert {row["quantity"] for row in gain} == {"specific_force.x", "specific_force.y"}
    for row in gain:
        assert row["before_m_s2"] == before["specific_force"][row["quantity"][-1]]["rms"]
        assert row["after_m_s2"] == after["specific_force"][row["quantity"][-1]]["rms"]
    assert not {code for code, _ in statements} & {"error_rises", "keep_declared_where"}
    assert ("load_robot_file", "") in statements
    error = [model["rollout_given_attitude"]["1"]["velocity"]["rms"] for model in (before, after)]
    assert error[1] < 0.5 * error[0]


def test_the_verdict_says_what_the_effect_is_worth(result: Path) -> None:
    verdict = json.loads((result / "verdict.json").read_text())
    (effect,) = verdict["effects"]
    for horizon in ("0.5", "1"):
        before, after = (verdict[model]["rollout"][horizon]["velocity"]["rms"] for model in ("before", "after"))
        assert effect["without_it"]["rollout"][horizon]["velocity"]["rises"] == pytest.approx(before / after - 1.0)
    assert effect["without_it"]["residual"]["channel"].startswith("specific_force")
    rival = effect["rival"]
    assert rival["name"] == "rotor_drag_of_thrust"
    assert rival["log_odds"] < -LEAST_SCORE
    assert f"log odds {rival['log_odds']:.1f}" in rival["because"]
    # In that channel another law of drag removes as much: only all channels together tell them apart.
    assert 0.99 < rival["instead_of"] < 1.0
    assert rival["explains"] == pytest.approx(rival["instead_of"], abs=1e-4)
    acts = effect["where_it_acts"]
    kind, axis = acts["channel"].split(".")
    assert acts["before"]["rms"] > 1.2 * verdict["before"][kind][axis]["rms"]  # drag acts at speed
    assert acts["gap_closed"] > 0.95
    parts = verdict["flights"]["f3"]
    for axis in "xy":  # the only test flight: what is said of it is said of all
        own, state = parts[f"specific_force.{axis}"], verdict["test_flights"][f"specific_force.{axis}"]
        assert (own["state"], own["rises"]) == ("better", pytest.approx(state["rises"]))
        assert own["after"] == pytest.approx(verdict["after"]["specific_force"][axis]["rms"])
        assert own["noise_floor"] == pytest.approx(verdict["after"]["specific_force"][axis]["noise_floor"])
    rollout, state = parts["free.velocity.1"], verdict["test_flights"]["free.velocity.1"]
    assert rollout["after"] < rollout["before"]
    assert rollout["rises"] == pytest.approx(state["rises"])


@pytest.mark.slow
def test_two_effects_that_only_forces_show_are_told_apart_by_no_manoeuvre(tmp_path: Path) -> None:
    tables = [flight(40 + seed, thrust_scale=0.9, noise=1.0, seconds=6.0, rate=100.0) for seed in range(3)]
    gyro = ["omega_x", "omega_y", "omega_z"]
    verdict = verdict_of_command(tmp_path, ROBOT, [table.drop(columns=gyro) for table in tables])
    assert verdict["verdict"] == "ambiguous"
    assert {"thrust_coefficient", "payload_mass"} <= set(verdict["candidates"])
    advice = verdict["manoeuvre"]
    assert {"thrust_coefficient", "payload_mass"} <= set(advice["tells"])
    assert advice["fly"] is None
    assert advice["expected_score_per_10s"] < 3.0
    assert "weigh_or_log" in [finding["code"] for finding in verdict["findings"]]


@pytest.mark.slow
def test_the_corrected_robot_loads_and_leaves_nothing_to_find(result: Path, folder: Path) -> None:
    corrected = load(RobotCfg, result / "robot.yaml")
    assert corrected.effects["rotor_drag"]["dx"] == pytest.approx(DRAG, rel=0.05)
    assert "f0, f1, f2" in corrected.effects_source
    assert replace(corrected, effects={}, effects_source="", randomize={}) == ROBOT
    train, test = [folder / f"f{n}.csv" for n in range(3)], [folder / "f3.csv"]
    second = close_loop(result / "robot.yaml", train, test, folder / "second")
    assert second.verdict == "none"
    assert second.effects == ()


def test_a_robot_draws_what_was_found_from_its_intervals(result: Path) -> None:
    """Over 4,000 environments: mean and deviation of each drawn drag are those of the verdict, within 5 standard errors."""
    (effect,) = json.loads((result / "verdict.json").read_text())["effects"]
    build = {"sim_name": "base_sim", "env_name": "empty_env", "controller_name": "lee_velocity_control"}
    env = SimBuilder().build_env(robot_name=result / "robot.yaml", num_envs=4000, device="cpu", **build)
    env.reset()
    draws = env.draws()
    assert set(draws) == {f"effects.rotor_drag.{axis}" for axis in effect["std"]}
    assert {"effects.rotor_drag.dx", "effects.rotor_drag.dy"} <= set(draws)
    for axis, std in effect["std"].items():
        drawn = draws[f"effects.rotor_drag.{axis}"]
        column = ["dx", "dy", "dz"].index(axis)
        assert (env.gtd["effect_rotor_drag"][:, column] == drawn).all()
        if effect["params"][axis] > 4.0 * std:  # else the bound at 0 cuts it
            assert abs(drawn.mean().item() - effect["params"][axis]) < 5.0 * std / 4000**0.5
            assert abs(drawn.std().item() / std - 1.0) < 5.0 / (2.0 * 4000) ** 0.5


def test_the_reports_stand_alone(result: Path, folder: Path) -> None:
    assert {path.name for path in result.iterdir()} == OUTPUTS
    page = (result / "report.html").read_text()
    assert page.count("<svg ") >= 5
    assert "http" not in page.replace("http-equiv", "")
    assert len(page) < 2e6
    places = [page.index(f'id="{part}"') for part in SECTIONS]
    assert places == sorted(places)
    assert "gap closed" in page
    assert '<td class="n better" title="better: -' in page  # axis by axis, flight by flight
    assert "<li>better: specific force x" in page
    assert page.index("Residual against thrust, speed, height and voltage") < page.index('id="effects"')
    assert "Residual of the" in page
    assert "rotor_drag" in (result / "report.md").read_text()
    table = pd.read_csv(result / "residuals.csv")
    assert set(table["set"]) == {"train", "test"}
    test = table[table["set"] == "test"]
    assert test["specific_force_x_after"].std() < 0.3 * test["specific_force_x_before"].std()
    log = pd.read_csv(folder / "f3.csv").query(f"{test['t'].min()} <= t <= {test['t'].max()}")
    assert test["specific_force_z_measured"].mean() == pytest.approx(log["acc_z"].mean(), rel=0.01)
    means = pd.read_csv(result / "profiles.csv")
    assert set(means["against"]) == {"thrust [N]", "speed [m/s]", "height [m]"}
    assert means["after"].notna().all()
    clues = pd.read_csv(result / "evidence.csv").set_index(["parameter", "channel"])
    assert clues.loc[("dx", "specific_force.x"), "alone"] == pytest.approx(DRAG, rel=0.1)
    record = json.loads((result / "run.json").read_text())
    assert record["config"]["seed"] == 0
    assert {Path(path).name for path in record["inputs"]} == {"f0.csv", "f1.csv", "f2.csv", "f3.csv", "f9.csv"}


def test_the_command_prints(run: tuple[Path, str]) -> None:
    out, printed = run
    record = json.loads((out / "run.json").read_text())
    assert (record["config"]["tolerances"]["mass"], record["config"]["tolerances"]["com"]) == (0.002, 0.0003)
    assert "rotor_drag: dx = 0.2" in printed
    verdict = json.loads((out / "verdict.json").read_text())
    assert f"verdict: explained {verdict['reason']}" in " ".join(printed.split())


def test_a_flight_that_cannot_be_used_is_said_to_be_left_out(run: tuple[Path, str]) -> None:
    out, printed = run
    findings = json.loads((out / "verdict.json").read_text())["findings"]
    (note,) = (one for one in findings if one["code"] == "flight_left_out")
    assert "f9.csv: ang_vel 2 is 0 in every row" in note["values"]["error"]
    assert "ang_vel 2 is 0 in every row" in " ".join(printed.split()).partition("rotor_drag: dx")[0]  # wrapped by rich
    assert "ang_vel 2 is 0 in every row" in (out / "report.html").read_text()


@pytest.mark.slow
def test_only_what_is_requested_is_searched(tmp_path: Path) -> None:
    hidden = {"drag": DRAG, "thrust_scale": 0.9, "seconds": 4.0, "rate": 100.0, "noise": 1.0}
    tables = [flight(60 + seed, **hidden) for seed in range(3)]
    verdict = verdict_of_command(tmp_path, ROBOT, tables, "--effects", "rotor_drag")
    assert [effect["name"] for effect in verdict["effects"]] == ["rotor_drag"]
    assert set(verdict["inclusion"]) == {"rotor_drag"}
    assert verdict["verdict"] != "explained"
    assert json.loads((tmp_path / "out" / "run.json").read_text())["config"]["effects"] == ["rotor_drag"]


@pytest.mark.slow
def test_the_function_returns_the_verdict_that_the_command_writes(tmp_path: Path) -> None:
    tables = [flight(60 + seed, drag=DRAG, seconds=4.0, rate=100.0, noise=1.0) for seed in range(3)]
    written = verdict_of_command(tmp_path, ROBOT, tables, "--effects", "rotor_drag")
    logs = [str(tmp_path / f"f{number}.csv") for number in range(3)]
    out = tmp_path / "function"
    verdict = loop_function(tmp_path / "robot.yaml", train=logs[:2], test=logs[2], out=out, effects="rotor_drag")
    assert json.loads((out / "verdict.json").read_text()) == written
    assert repr(verdict).startswith(f"Verdict {written['verdict']}: rotor_drag (dx = 0.2")


def test_the_command_refuses(folder: Path, call: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    test, robot, train, known = call[-1], call[2], call[4:7], folder.parent / "wrong_tolerances.yaml"
    known.write_text("mas: 0.002\n")
    before = sorted(path.name for path in folder.iterdir())
    bad = pd.read_csv(test)
    bad.loc[100:110, "omega_y"] = np.nan
    wrong = write(bad, folder / "bad.csv")
    for arguments, message in (
        ([*call[:-1], str(wrong), "--out", str(folder / "new")], "bad.csv, line 102: omega_y is empty (NaN)"),
        ([*call, "--out", str(folder)], "holds other files; give a new or empty folder"),
        ([*call[:-1], train[0], "--out", str(folder / "new")], "is given twice"),
        ([*call, "--out", str(folder / "new"), "--bandwidth-hz", "0"], "bandwidth_hz = 0.0: must lie in [0.5, 100] Hz"),
        ([*call, "--out", str(folder / "new"), "--mapping", "px4"], "no log mapping 'px4'"),
        (["close-loop", "--robot", "nobody", *call[3:], "--out", str(folder / "new")], "no robot 'nobody'"),
        ([*call, "--out", str(folder / "new"), "--tolerances", str(known)], "mas"),
        ([*call, "--out", str(folder / "new"), "--effects", "rotor_dragg"], "Did you mean 'rotor_drag'"),
        ([*call, "--out", str(folder / "new"), "--effects", "gusts"], "gusts is random"),
        ([*call, "--out", str(folder / "new"), "--material", "5"], "material = 5.0: must lie in [0, 1)"),
        (["replay", robot, str(folder / "none.csv")], "none.csv: no such file"),
    ):
        assert main(arguments) == 2, arguments
        error = capsys.readouterr().err
        assert message in error
        assert "Traceback" not in error
    wrong.unlink()
    assert sorted(path.name for path in folder.iterdir()) == before


def test_replay_fits_nothing(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    results = replay(folder / "robot.yaml", [folder / "f3.csv"], folder / "replayed")
    files = {"replay.json", "report.html", "residuals.csv", "profiles.csv", "run.json"}
    assert {path.name for path in (folder / "replayed").iterdir()} == files
    assert results.evaluation.residual[0].value > 0.1
    assert main(["replay", str(folder / "robot.yaml"), str(folder / "f3.csv"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["replay"]["specific_force"]["x"]["rms"] == pytest.approx(results.evaluation.residual[0].value)
    assert results.evaluation.floor is not None
    ratios = [
        one.value / floor for one, floor in zip(results.evaluation.residual, results.evaluation.floor, strict=True)
    ]
    assert results.answer.code == "errors_above_floor"
    assert results.answer.values["ratio"] == max(ratios)
    assert results.answer.values["above"] == sum(ratio > 1.1 for ratio in ratios)


def test_a_replay_goes_on_beside_an_unusable_log_and_says_so(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rotors of one log are in another order."""
    table, names = pd.read_csv(folder / "f2.csv"), [f"rotor_{n}" for n in (1, 2, 3, 4)]
    wrong = write(table.assign(rotor_1=table["rotor_2"], rotor_2=table["rotor_1"]), folder.parent / "wrong.csv")
    files = [str(folder / "f3.csv"), str(wrong)]
    assert main(["replay", str(folder / "robot.yaml"), *files, "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    assert printed["flights"] == files[:1]
    assert "rotor_2, rotor_1" in printed["left_out"][0]
    with pytest.raises(DataError, match=f"the probable order is {names[1]}"):
        replay(folder / "robot.yaml", [wrong])


def test_a_replay_rolls_nothing_out_that_the_log_does_not_begin(folder: Path, tmp_path: Path) -> None:
    whole = pd.read_csv(folder / "f3.csv")
    blind = write(whole.drop(columns=[c for c in whole if c.startswith(("p_", "v_"))]), tmp_path / "blind.csv")
    replay(folder / "robot.yaml", [blind], tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert text(Finding("rollouts_lack_velocity", "blind")) in page
    assert "<th>variant</th>" not in page


def test_a_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def run(text: str, *, fail: bool) -> None:
        with atomic_run_folder(out) as partial:
            (partial / "run.json").write_text(json.dumps({"run": text}))
            (partial / f"{text}.txt").write_text(text)
            if fail:
                raise OSError("disk full")

    assert_refused(OSError, "disk full", run, "first", fail=True)
    assert list(tmp_path.iterdir()) == []
    run("second", fail=False)
    assert_refused(OSError, "disk full", run, "third", fail=True)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert json.loads((out / "run.json").read_text())["run"] == "second"
    (out / "notes.txt").write_text("of a person")
    run("fourth", fail=False)  # what an earlier run wrote is replaced, and nothing else
    assert json.loads((out / "run.json").read_text())["run"] == "fourth"
    assert sorted(path.name for path in out.iterdir()) == ["fourth.txt", "notes.txt", "run.json"]
    assert (out / "notes.txt").read_text() == "of a person"


@pytest.mark.parametrize("files", [["../kept.txt", "/etc/hostname", ".", ""], "kept.txt", None, [3]])
def test_a_record_that_was_changed_deletes_nothing_else(files: object, tmp_path: Path) -> None:
    (tmp_path / "kept.txt").write_text("")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "run.json").write_text(json.dumps({"files": files}))
    with atomic_run_folder(tmp_path / "out") as partial:
        (partial / "run.json").write_text("{}")
    assert (tmp_path / "kept.txt").exists()


def test_a_full_disk_ends_a_run_with_a_sentence_and_leaves_what_was(tmp_path: Path) -> None:
    def run() -> None:
        with atomic_run_folder(tmp_path / "out") as partial:
            (partial / "run.json").write_text("{}")
            raise OSError(errno.ENOSPC, "No space left on device")

    assert_refused(StorageError, "out: cannot be written, the disk is full", run)
    assert list(tmp_path.iterdir()) == []


def test_training_and_testing_need_a_flight_each(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="at least one flight to train on"):
        close_loop(folder / "robot.yaml", [], [folder / "f3.csv"], tmp_path / "out")
    with pytest.raises(ConfigError, match="bandwidth_hz"):
        close_loop(folder / "robot.yaml", [folder / "f0.csv"], [folder / "f3.csv"], tmp_path / "out", bandwidth=1e9)
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="is a file; give a folder"):
        close_loop(folder / "robot.yaml", [folder / "f0.csv"], [folder / "f3.csv"], tmp_path / "file")


def test_forces_at_an_unknown_airspeed_are_not_called_unexplained(tmp_path: Path) -> None:
    robot = replace(ROBOT, effects={"rotor_drag": {"dx": DRAG, "dy": DRAG, "dz": DRAG}}, effects_source="flown with it")
    paths = [tmp_path / f"f{seed}.csv" for seed in range(2)]
    for seed, path in enumerate(paths):
        table = flight(50 + seed, drag=DRAG, noise=1.0, seconds=4.0, rate=100.0)
        write(table.drop(columns=[f"{name}_{axis}" for name in "pv" for axis in "xyz"]), path)
    flights = load_train_and_test(robot, paths[:1], paths[1:], None, 10.0)
    with one_thread():
        verdict = judge_flights(robot, *flights).verdict
    assert verdict.verdict == "none"
    assert verdict.unexplained == ()
    codes = [finding.code for finding in all_findings(verdict)]
    assert {"forces_not_judged", "log_velocity"} <= set(codes)


@pytest.mark.slow
def test_a_vehicle_that_bends_is_said_to_be_taken_as_rigid_and_gets_no_effect_that_it_cannot_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    arm = LinkCfg(mass=0.02, com=ROBOT.mounts.layout[0].position, inertia=still)
    hinge = JointCfg(name="arm", axis=(0.0, 1.0, 0.0), position=(0.05, -0.05, 0.01), link=arm)
    bending = replace(ROBOT, joints=JointsCfg(layout=(hinge,), source="invented"))
    tables = [flight(seed, spring=0.5, noise=1.0, seconds=4.0, rate=100.0) for seed in range(3)]
    verdict = verdict_of_command(tmp_path, bending, tables, "--effects", "joint_spring", "rotor_drag")
    said = text(Finding("joints_held", "", {"joints": ["arm"]}))
    assert f"note: {said}" in " ".join(capsys.readouterr().out.split())
    assert verdict["notes"][0] == said
    assert said in (tmp_path / "out" / "report.html").read_text()
    assert "this one has joints" in verdict["not_testable_because"]["joint_spring"]
    check_effects(load(RobotCfg, tmp_path / "out" / "robot.yaml"))
    assert main(["replay", str(tmp_path / "robot.yaml"), str(tmp_path / "f0.csv")]) == 0
    assert f"note: {said}" in " ".join(capsys.readouterr().out.split())
