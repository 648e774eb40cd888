"""Before and after axis by axis and flight by flight, against known numbers; what gets worse on one flight is marked."""

import numpy as np
import pytest

from aerial_gym.sim2real.judge.breakdown import FlightError, errors_by_flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.tables import flight_table
from tests.unit.sim2real.flat_flights import PredictorStub
from tests.unit.sim2real.judge.builders import FORCES, make_evaluation, make_named_effect, make_verdict
from tests.unit.sim2real.predict.test_scene import hover

FACTORS = {"calm": (1.3, 0.5, 1.0), "gusty": (0.7, 0.5, 1.01)}
"""By which each flight's residual changes along each axis: x gets worse in one flight and better in the other."""


@pytest.fixture
def parts() -> dict[str, list[FlightError]]:
    rng = np.random.default_rng(0)
    before = {name: size * rng.standard_normal((600, 3)) for name, size in (("calm", 0.1), ("gusty", 0.4))}
    models = ModelParams(), ModelParams(effects={"rotor_drag": np.ones(3)})
    predictor = PredictorStub(
        lambda model: [rows * (1.0 - np.array(FACTORS[name])) * bool(model.effects) for name, rows in before.items()],
        list(before.values()),
        flights=[hover(name, 1.0) for name in FACTORS],
        channels=FORCES,
    )
    floors, empty = [np.array([0.05, 0.04, 0.03]), None], make_evaluation(0.1, 0.1, 0.1)
    return errors_by_flight(predictor, models, (empty, empty), floors, least=0.05, seed=0)


def test_every_axis_of_every_flight_has_its_own_numbers(parts: dict[str, list[FlightError]]) -> None:
    states = {name: [part.became.state for part in own] for name, own in parts.items()}
    assert states == {"calm": ["worse", "better", "same"], "gusty": ["better", "better", "same"]}
    for name, factors in FACTORS.items():
        for part, factor in zip(parts[name], factors, strict=True):
            assert part.became.rise.value == pytest.approx(factor - 1.0, rel=1e-9)
            assert part.after.value == pytest.approx(factor * part.before.value, rel=1e-9)
            assert part.before.value == pytest.approx({"calm": 0.1, "gusty": 0.4}[name], rel=0.1)
    assert [part.floor for part in parts["calm"]] == [0.05, 0.04, 0.03]
    assert parts["gusty"][0].as_mapping()["noise_floor"] is None


def test_the_table_marks_what_got_worse(parts: dict[str, list[FlightError]]) -> None:
    verdict = make_verdict(flights=parts, effects=(make_named_effect(),))
    table = flight_table(verdict, ["specific_force"])
    assert table["names"] == ["calm", "gusty"]
    (worse,) = table["worse"]
    assert worse.startswith("specific force x +30.0%")
    assert worse.endswith("on calm")
    assert [row["quantity"] for row in table["rows"]] == [f"specific force {axis} [m/s²]" for axis in "xyz"]
    cells = table["rows"][0]["cells"]
    assert (cells["calm"]["state"], cells["gusty"]["state"]) == ("worse", "better")
    assert (cells["calm"]["floor"], cells["gusty"]["floor"]) == ("0.05", None)
    assert flight_table(verdict, ["rotor_speed"])["rows"] == []
