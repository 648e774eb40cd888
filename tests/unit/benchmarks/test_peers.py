"""``python -m benchmarks.peers``: the ratios from given figures, the order of a round, and peers that are not there."""

import sys
from pathlib import Path

import pytest

from aerial_gym.errors import ConfigError
from benchmarks.peers.__main__ import PeersCmd
from benchmarks.peers.runs import CASES, PEERS, Measurement, ratios, run_python, schedule
from benchmarks.peers.timing import Request, StepBlock, check_flight, measure_rates

PEER_FILES = sorted((Path(__file__).parents[3] / "benchmarks" / "peers").glob("peer_*.py"))


def make_measurement(name: str, case: str, rate: float, substeps: int | None = None) -> Measurement:
    call = "1" if substeps is None else str(substeps)
    return Measurement(name=name, case=case, substeps=substeps, rates=(rate,), version="1", dt_s=0.002, call=call)


GIVEN = [
    make_measurement("aerial_gym", "plant", 10.0, 1), make_measurement("crazyflow", "plant", 4.0),
    make_measurement("aerial_gym", "plant", 30.0, 10), make_measurement("aerial_gym", "plant", 20.0, 1),
    make_measurement("crazyflow", "plant", 6.0), make_measurement("aerial_gym", "plant", 90.0, 1),
    make_measurement("crazyflow", "plant", 5.0), make_measurement("aerial_gym", "rk4", 8.0, 1),
    make_measurement("l2f", "rk4", 16.0),
]  # fmt: skip


def test_ratios_are_those_of_the_medians_of_all_rounds() -> None:
    result = {(row.peer.case, row.peer.name, row.package.call): row for row in ratios(GIVEN)}
    assert result.keys() == {("plant", "crazyflow", "1"), ("plant", "crazyflow", "10"), ("rk4", "l2f", "1")}
    assert result["plant", "crazyflow", "1"].ratio == 20.0 / 5.0
    assert result["plant", "crazyflow", "10"].ratio == 30.0 / 5.0
    assert result["rk4", "l2f", "1"].ratio == 0.5
    assert result["plant", "crazyflow", "1"].as_mapping()["peer_rounds"] == (4.0, 6.0, 5.0)


def test_ours_and_the_peers_take_turns() -> None:
    assert list(schedule("rk4", ["crazyflow", "l2f", "mujoco"], (1, 10))) == [1, "crazyflow", 10, "l2f", 1, "mujoco"]
    assert list(schedule("attitude", ["l2f", "crazyflow"], (1, 10))) == [1, "crazyflow", 10]
    assert list(schedule("attitude", ["l2f"], (1, 10))) == []


def test_a_process_is_pinned_to_as_many_cores_as_it_has_threads() -> None:
    code = "import os; print(len(os.sched_getaffinity(0)), os.environ['OMP_NUM_THREADS'])"
    assert run_python(sys.executable, ["-c", code], threads=1) == "1 1"


def test_an_unknown_case_is_refused() -> None:
    with pytest.raises(ConfigError, match="no case 'plnt'. Known: plant"):
        PeersCmd(cases=("plnt",)).run()


def test_every_peer_has_a_file_that_says_what_a_step_holds() -> None:
    assert {path.stem.removeprefix("peer_") for path in PEER_FILES} == set(PEERS)
    assert all(set(PEERS.get(name).cases) <= set(CASES) for name in PEERS)


def test_a_peers_file_imports_none_of_our_code_but_the_timing() -> None:
    texts = {path.stem: path.read_text(encoding="utf-8") for path in PEER_FILES}
    assert [name for name, text in texts.items() if "A step holds:" not in text or "aerial_gym" in text] == []


def test_a_peer_is_timed_and_watched() -> None:
    height = [0.0]

    def climb() -> None:
        height[0] += 1e-6

    request = Request(case="plant", num_envs=1, threads=1, device="cpu", repeats=3, repeat_time_s=0.005)
    batch = StepBlock(
        steps=10, dt=1e-3, run=climb, restart=lambda: height.__setitem__(0, 0.0), wait=lambda: None,
        heights=lambda: list(height),
    )  # fmt: skip
    rates = measure_rates(request, batch)
    assert len(rates) == 3
    assert min(rates) > 0.0
    for after in (0.0, float("nan"), 5000.0):
        with pytest.raises(RuntimeError, match="did not fly"):
            check_flight([0.0], [after])
