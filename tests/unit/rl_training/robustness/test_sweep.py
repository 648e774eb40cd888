"""Flights of cells against plain evaluations, and the statistics of their results."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.export.export import export_policy
from aerial_gym.export.pilot import load_pilot
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.robustness.cell import CLEAN, Cell, CellGroup, Plan, Variant
from aerial_gym.rl_training.robustness.figure import write_figure
from aerial_gym.rl_training.robustness.plan import make_plan
from aerial_gym.rl_training.robustness.result import CellFlights, Robustness, judge
from aerial_gym.rl_training.robustness.sweep import CheckablePilot, fly_cells
from tests.unit.rl_training.robustness.test_cells import HOVER, RANGES

POLICY, TASK = load_pilot(Path("pretrained/position_setpoint_task"), "cpu")[0], HOVER
FLIGHTS = 24
NEUTRAL = ('robot.effects.com_offset={"x": 0.0, "y": 0.0, "z": 0.0}', "robot.effects_source=test")
SHIFTED = Cell(
    name="shifted", label="shifted", subject="com_offset", variants=(Variant(values={("com_offset", "x"): 0.001}),)
)
LATE = replace(CLEAN, name="late", subject="delay", delay_steps=5)


def fly(*groups: CellGroup, policy: CheckablePilot = POLICY) -> Robustness:
    return [*fly_cells(policy, TASK, Plan(groups=groups), flights=FLIGHTS, trained_on=TASK.name)][-1]


@pytest.mark.parametrize(
    ("group", "settings"),
    [
        (
            CellGroup(cells=(CLEAN, SHIFTED), settings=NEUTRAL),
            ('robot.effects.com_offset={"x": 0.001, "y": 0.0, "z": 0.0}',),
        ),
        (CellGroup(cells=(CLEAN, LATE), settings=("task.action.delay_steps=[0, 5]",)), ("task.action.delay_steps=5",)),
    ],
)
def test_a_cell_flies_like_a_plain_evaluation_with_its_settings(group: CellGroup, settings: tuple[str, ...]) -> None:
    (cell,) = fly(group).cells
    more = (*settings, "robot.effects_source=test") if "effects" in settings[0] else settings
    with TASK.make(FLIGHTS, more) as task:
        plain = evaluate(POLICY, task)
    assert (cell.success_rate, cell.crash_rate) == (plain.success_rate, plain.crash_rate)
    assert cell.error_mean_m == pytest.approx(plain.final_error_mean_m, rel=1e-6)


def test_a_policy_fails_without_a_rotor_and_succeeds_in_clean_flight() -> None:
    lost = tuple(
        Variant(values={("motor_failure", "motor"): float(n), ("motor_failure", "scale"): 0.0}, label=f"rotor {n}")
        for n in (1, 2, 3, 4)
    )
    cell = Cell(name="lost", label="a lost rotor", subject="motor_failure", variants=lost)
    inert = replace(cell, name="inert", variants=(Variant(values={("motor_failure", "time"): 100.0}),))
    neutral = replace(CLEAN, name="neutral")
    settings = ('robot.effects.motor_failure={"motor": 1.0, "scale": 1.0, "time": 0.0}', "robot.effects_source=test")
    result = fly(CellGroup(cells=(CLEAN,)), CellGroup(cells=(neutral, inert, cell), settings=settings, compared=True))
    assert result.complete
    assert result.clean.success_rate > 0.9
    assert result.cells[0].name == "lost"  # worst first
    assert {each.name: each.outcome for each in result.cells} == {
        "lost": "fails", "inert": "no change", "neutral": "holds",
    }  # fmt: skip
    assert result.cells[0].success_rate == 0.0
    assert result.cells[0].advice.startswith("Most flights fail with a lost rotor: ")


def test_lost_packets_repeat_the_last_observation() -> None:
    """With every packet lost the first action stays, so that the vehicle does not stop at the target."""
    losses = tuple(replace(CLEAN, name=f"{loss:g}", subject="packet_loss", loss=loss) for loss in (0.0, 1.0))
    result = fly(CellGroup(cells=(CLEAN, *losses)))
    figures = {each.name: each for each in result.cells}
    assert figures["0"].successes == result.clean.successes
    assert figures["0"].error_mean_m == result.clean.error_mean_m
    assert figures["1"].success_rate < 0.1


@pytest.mark.slow
def test_intervals_of_a_robot_file_fly_like_plain_evaluations(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(RANGES.format(mean=0.001, std=0.0002))
    plan = make_plan(TASK, quick=True, ranges=file)
    result = fly(CellGroup(cells=(CLEAN,)), *(group for group in plan.groups if group.robot))
    errors = {each.name: each.error_mean_m for each in result.cells}
    fixed = "robot.randomize.effects.com_offset.x=null"
    high = (fixed, f"robot.effects.com_offset.x={0.001 + 1.96 * 0.0002}")
    for name, settings in (("all", ()), ("means", (fixed,)), ("com_offset.x/high", high)):
        with TASK.make(FLIGHTS, settings, robot=str(file)) as task:
            assert errors[f"ranges/{name}"] == pytest.approx(evaluate(POLICY, task).final_error_mean_m, rel=1e-6)


def test_an_exported_policy_has_the_same_figures(tmp_path: Path) -> None:
    (exported,) = export_policy("pretrained/position_setpoint_task", tmp_path, ["torchscript"], check=False)
    group = CellGroup(cells=(CLEAN, replace(CLEAN, name="lossy", subject="packet_loss", loss=0.2)))
    before, after = fly(group), fly(group, policy=load_pilot(exported.file, "cpu")[0])
    for each, other in ((before.clean, after.clean), (before.cells[0], after.cells[0])):
        assert (each.successes, each.crash_rate) == (other.successes, other.crash_rate)
        assert each.error_mean_m == pytest.approx(other.error_mean_m, rel=1e-3)


def test_statistics_of_pairs_and_shares(tmp_path: Path) -> None:
    """Ten of ten starts lost: p = 2^-10. All of n succeed: the interval begins at (1 - 0.95) / 2 to the power 1/n."""
    good, bad = torch.ones(10, dtype=torch.bool), torch.zeros(10, dtype=torch.bool)
    error = torch.full((10,), 0.25)
    cells = [
        CellFlights(replace(CLEAN, name=name, subject="noise"), rows, bad, error, False)
        for name, rows in (("a", good), ("b", bad), ("c", good))
    ]
    result = judge(cells, Plan(groups=(CellGroup(cells=tuple(each.cell for each in cells)),)))
    assert [each.name for each in result.cells] == ["b", "c"]
    assert result.cells[0].p_value == pytest.approx(2.0**-10)
    assert (result.cells[0].outcome, result.cells[1].outcome, result.cells[1].p_value) == ("fails", "holds", 1.0)
    assert result.clean.success_low == pytest.approx(0.025**0.1)
    assert result.clean.error_mean_m == 0.25
    never = judge([replace(each, succeeded=bad) for each in cells], Plan(groups=(CellGroup(cells=(CLEAN,)),)))
    assert {each.outcome for each in never.cells} == {"not shown"}
    write_figure(result, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 0


def test_plot_of_flights_that_all_crash_has_no_errors(tmp_path: Path) -> None:
    crashed, rows = torch.ones(4, dtype=torch.bool), torch.zeros(4, dtype=torch.bool)
    cells = [CellFlights(replace(CLEAN, name=name), rows, crashed, torch.full((4,), 9.0), False) for name in "ab"]
    result = judge(cells, Plan(groups=(CellGroup(cells=tuple(each.cell for each in cells)),)))
    assert result.clean.error_mean_m is None
    write_figure(result, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 0
