"""Payloads and cut propellers by the balance at hover of Crazyflies without gyro and attitude (CrazyPAD, Data 2024, 9,
79). Both logs of a condition decide; parameters come from one and are judged on the other. Every other pair shows how
much two logs differ."""

import json
import random
from itertools import product
from pathlib import Path

import pytest

from aerial_gym.cli.main import main
from aerial_gym.robots.catalog import ROBOTS
from aerial_gym.sim2real import find_mapping, read_flight_log
from aerial_gym.sim2real.teststand.balance import (
    Balance,
    HoverEffort,
    hover_effort,
    judge_balance,
    repeats_by_condition,
)

DATA = Path(__file__).parents[2].parent / "shared" / "data" / "crazypad"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"the measured flights are not on this machine: {DATA}")

STUDY = {
    "add_weight_W1_near_M3_E9": (0.250, 0.236, 0.302, 0.211, 23.7),
    "add_weight_W3_near_M3_E9": (0.248, 0.208, 0.358, 0.187, 24.8),
    "cut_propeller_M3_3mm_E9": (0.257, 0.236, 0.305, 0.201, 24.7),
    "normal_flight_E9": (0.255, 0.243, 0.287, 0.215, 23.6),
    "add_weight_W1_near_M4_E8": (0.276, 0.205, 0.288, 0.231, 22.4),
    "add_weight_W1_near_M3_M4_E8": (0.258, 0.194, 0.302, 0.245, 23.7),
    "cut_propeller_M3_3mm_E8": (0.276, 0.197, 0.322, 0.204, 23.5),
    "normal_flight_E8": (0.279, 0.211, 0.288, 0.222, 22.4),
}
"""Shares and sum of (pwm V)² [V²], measured_data.md 3.8."""


@pytest.fixture(scope="module")
def pairs() -> dict[str, list[HoverEffort]]:
    layout = find_mapping("crazypad")
    logs = [hover_effort(read_flight_log(path, mapping=layout, hover=True)) for path in sorted(DATA.glob("*.csv"))]
    return {name.removesuffix("_log"): pair for name, pair in repeats_by_condition(logs).items()}


def judge(
    pairs: dict[str, list[HoverEffort]],
    condition: str,
    *,
    first: int = 0,
    baseline: tuple[int, ...] = (0, 1),
    aside=None,
) -> Balance:
    """The verdict on a condition; ``first`` is the log that decides, ``aside`` another condition that is not used."""
    normal = f"normal_flight_{condition[-2:]}"
    rest = [hover for name, pair in pairs.items() if name not in (condition, normal, aside) for hover in pair]
    flight, test = pairs[condition][first], pairs[condition][1 - first]
    usual = [pairs[normal][log] for log in baseline]
    return judge_balance(usual, [flight], robot=ROBOTS.get("crazyflie_21"), test=[test], repeats=rest)


def right(condition: str, result: Balance) -> bool:
    """Whether nothing is named, or the cause is among what is: a weight off the centre, or motor 3 with or without its drag."""
    cause = "weak_motor 3" if condition.startswith("cut") else "payload_mass + com_offset"
    return result.candidates == () or any(name.startswith(cause) for name in result.candidates)


def test_shares_are_those_of_the_study(pairs: dict[str, list[HoverEffort]]) -> None:
    """Within 0.004, the spread between logs that the study gives, and 1 % of the sum: windows are chosen in another way."""
    for condition, (*shares, total) in STUDY.items():
        efforts = [hover.effort for hover in pairs[condition]]
        mean = sum(effort / effort.sum() for effort in efforts) / len(efforts)
        assert mean == pytest.approx(shares, abs=0.004)
        assert sum(effort.sum() for effort in efforts) / len(efforts) == pytest.approx(total, rel=0.012)


def test_a_weight_between_two_motors_is_named_in_its_place(pairs: dict[str, list[HoverEffort]]) -> None:
    """W1 near M3 and M4, on the left side: the mass is only in photographs; whichever log decides, the other agrees."""
    for first in (0, 1):
        results = judge(pairs, "add_weight_W1_near_M3_M4_E8", first=first)
        assert (results.verdict, results.candidates) == ("explained", ("payload_mass + com_offset",))
        (fit,) = (fit for fit in results.fits if fit.cause.name == results.candidates[0])
        assert fit.params["dm"].low > 0.0
        assert fit.params["y"].low > 0.0
        assert abs(fit.params["x"].value) < 0.4 * fit.params["y"].value
        assert fit.held_out < 0.3 * (results.fits[0].held_out or 0.0)


def test_a_propeller_cut_by_3_mm_is_named(pairs: dict[str, list[HoverEffort]]) -> None:
    """Motor 3 of E8, whichever log decides; of E9, half as far from the baseline, it is the most probable candidate."""
    for first in (0, 1):
        results = judge(pairs, "cut_propeller_M3_3mm_E8", first=first)
        assert (results.verdict, results.candidates) == ("explained", ("weak_motor 3",))
    results = judge(pairs, "cut_propeller_M3_3mm_E9")
    assert (results.verdict, results.candidates) == ("unexplained", ())
    assert max(results.fits[:-1], key=lambda fit: fit.probability).cause.name == "weak_motor 3 + torque_ratio"


def test_small_changes_are_not_told_from_scatter(pairs: dict[str, list[HoverEffort]]) -> None:
    for condition in ("add_weight_W1_near_M3_E9", "add_weight_W1_near_M4_E8"):
        assert judge(pairs, condition).verdict == "none"
    for condition in ("cut_propeller_M3_1mm_E8", "cut_propeller_M3_1mm_E9", "cut_propeller_M3_2mm_E8"):
        assert judge(pairs, condition).verdict == "none"


@pytest.mark.parametrize("baseline", [(0, 1), *(pytest.param(one, marks=pytest.mark.slow) for one in ((0,), (1,)))])
def test_no_name_is_wrong_with_logs_kept_aside(pairs: dict[str, list[HoverEffort]], baseline: tuple[int, ...]) -> None:
    conditions = [name for name in pairs if not name.startswith("normal")]
    for condition in conditions:
        for first in (0, 1):
            assert right(condition, judge(pairs, condition, first=first, baseline=baseline))
        for aside in pairs:
            if aside not in (condition, f"normal_flight_{condition[-2:]}"):
                assert right(condition, judge(pairs, condition, baseline=baseline, aside=aside))


@pytest.mark.slow
def test_names_with_few_repeats_are_wrong_no_more_often_than_promised(pairs: dict[str, list[HoverEffort]]) -> None:
    """Three to seven of the other conditions, drawn: 1 % is promised where a set of names is given at all."""
    rng, wrong, verdicts = random.Random(0), list[str](), 0
    for condition in (name for name in pairs if not name.startswith("normal")):
        normal = f"normal_flight_{condition[-2:]}"
        rest = [name for name in pairs if name not in (condition, normal)]
        for count, first, baseline in product(range(3, 8), (0, 1), ((0, 1), (0,), (1,))):
            for _ in range(2):
                kept = rng.sample(rest, count)
                usual, flight = [pairs[normal][log] for log in baseline], pairs[condition]
                hovers = [hover for name in kept for hover in pairs[name]]
                robot = ROBOTS.get("crazyflie_21")
                results = judge_balance(usual, [flight[first]], robot=robot, test=[flight[1 - first]], repeats=hovers)
                verdicts += 1
                if results.fits and not right(condition, results):
                    wrong.append(f"{condition} {results.freedom} {results.candidates}")
    print(f"{len(wrong)} of {verdicts} verdicts hold a wrong name and not the right one: {wrong}")
    assert len(wrong) < 0.01 * verdicts


def test_the_heavy_weight_is_no_balance_of_weights(pairs: dict[str, list[HoverEffort]]) -> None:
    """W3 near M3: motors 2 and 4 lose what balances yaw, which no weight does. It is a payload, and it is not named."""
    results = judge(pairs, "add_weight_W3_near_M3_E9")
    assert (results.verdict, results.candidates) == ("unexplained", ())
    assert results.shares[2].change.low > 0.06
    assert max(results.shares[1].change.high, results.shares[3].change.high) < 0.0


def test_the_command_reads_the_logs(capsys: pytest.CaptureFixture[str]) -> None:
    def paths(pattern: str) -> list[str]:
        return [str(path) for path in sorted(DATA.glob(pattern))]

    flight, test = paths("cut_propeller_M3_3mm_E8_*")
    argv = ("identify", "hover", flight, "--test", test, "--baseline", *paths("normal_flight_E8_*"))
    common = ("--repeats", *paths("*.csv"), "--robot", "crazyflie_21", "--mapping", "crazypad", "--json")
    assert main([*argv, *common]) == 0
    results = json.loads(capsys.readouterr().out)
    assert (results["verdict"], results["candidates"]) == ("explained", ["weak_motor 3"])
    assert results["scatter"]["freedom"] == 10
