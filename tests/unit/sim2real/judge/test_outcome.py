"""Changes of errors and what effects are worth, against known numbers; whatever gets worse is named."""

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.select import Rival
from aerial_gym.sim2real.judge.ablation import Ablation, highest_reliable_frequency, reason_against_rival
from aerial_gym.sim2real.judge.breakdown import FlightError, errors_by_flight
from aerial_gym.sim2real.judge.evaluation import gap_closed
from aerial_gym.sim2real.judge.outcome import Decision, decision_on_materiality, decision_with_harm
from aerial_gym.sim2real.judge.verdict import notes_on_materiality
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.tables import flight_table
from aerial_gym.sim2real.statistics import Rise, rise_with_interval
from tests.unit.sim2real.flat_flights import PredictorStub
from tests.unit.sim2real.judge.builders import FORCES, make_evaluation, make_named_effect, make_outcome, make_verdict
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import make_fit


@pytest.mark.parametrize(("rise", "state", "suspect"), [
    ((0.62, 0.4, 0.9), "worse", False),
    ((0.09, -0.16, 0.37), "not shown", True),
    ((-0.09, -0.37, 0.16), "not shown", False),
    ((-0.3, -0.4, -0.1), "better", False),
    ((0.01, 0.002, 0.02), "same", False),  # certain, and a trifle
    ((0.0, 0.0, 0.0), "same", False),
    ((0.04, 0.01, 0.08), "worse", False),
    ((0.2, -1.0, np.inf), "not shown", True),
])  # fmt: skip
def test_a_change_is_called_what_its_interval_shows(rise: tuple, state: str, suspect: bool) -> None:
    result = make_outcome("x", *rise)
    assert (result.state, result.is_possibly_worse) == (state, suspect)


def test_an_outcome_of_a_rollout_has_its_horizon_in_its_name() -> None:
    assert make_outcome("specific_force.x", 0.1, 0.0, 0.2).name == "specific_force.x"
    assert make_outcome("free.velocity", 0.1, 0.0, 0.2, 0.5).name == "free.velocity.0.5"


def test_an_interval_over_flights_holds_where_flights_differ() -> None:
    """Each flight has a ratio of its own, with a standard deviation of 0.3 in its logarithm about log 1.2; blocks within a
    flight agree. 95 % of the intervals must hold the rms of the ratios, 1.2 exp(0.3^2): 400 trials of 8 flights, 380 +- 4.4,
    a little less since few flights scatter skewed."""
    inside, rng, truth = 0, np.random.default_rng(3), 1.2 * np.exp(0.3**2) - 1.0
    flight, group = np.repeat(np.arange(8), 100), np.repeat(np.arange(80), 10)
    for _ in range(400):
        ratio = 1.2 * np.exp(0.3 * rng.standard_normal(8))
        reference = rng.standard_normal((800, 1))
        (rise,) = rise_with_interval(ratio[flight][:, None] * reference, reference, group, flight)
        inside += rise.low < truth < rise.high
    assert 0.90 * 400 <= inside <= 0.985 * 400


@pytest.mark.parametrize(("ratios", "rises", "falls"), [
    ((1.6, 1.0, 1.5), True, False),  # it acts in two flights of three
    ((1.6, 1.0, 1.0), True, False),  # in one flight alone
    ((1.6, 0.7, 1.5), False, False),  # one flight contradicts
    ((0.6, 1.0, 0.7), False, True),
])  # fmt: skip
def test_flights_that_an_effect_leaves_alone_contradict_nothing(ratios: tuple, *, rises: bool, falls: bool) -> None:
    """The interval over three flights holds 0, since they differ; those that change agree nevertheless."""
    reference = np.random.default_rng(2).standard_normal((900, 1))
    flight, group = np.repeat(np.arange(3), 300), np.repeat(np.arange(90), 10)
    (rise,) = rise_with_interval(np.array(ratios)[flight][:, None] * reference, reference, group, flight)
    assert rise.low < 0.0 < rise.high
    assert (rise.reaches(0.05, least=0.05), rise.falls(least=0.05)) == (rises, falls)


def test_one_flight_is_not_enough_where_the_others_are_open() -> None:
    """The second flight has the effect as well, but its noise hides it."""
    rng, flight, group = np.random.default_rng(4), np.repeat(np.arange(3), 300), np.repeat(np.arange(90), 10)
    less, more = rng.standard_normal((2, 900, 1))
    values = np.where((flight == 1)[:, None], more, np.array([1.6, 1.0, 1.0])[flight][:, None] * less)
    (rise,) = rise_with_interval(values, less, group, flight)
    assert not rise.reaches(0.05, least=0.05)


def test_one_block_has_no_interval() -> None:
    values = np.ones((5, 1))
    (rise,) = rise_with_interval(2.0 * values, values, np.zeros(5, dtype=int), np.zeros(5, dtype=int))
    assert (rise.value, rise.low) == (pytest.approx(1.0), -1.0)
    assert rise.as_mapping()["interval"] == [-1.0, None]


def test_the_gap_closed_is_the_share_of_what_lies_above_the_floor() -> None:
    """3² to 2² above 1²: 5 of 8; down to the floor: all; worse than before: negative; nothing above it: no answer."""
    assert gap_closed(3.0, 2.0, 1.0) == pytest.approx(5.0 / 8.0, rel=1e-12)
    assert gap_closed(3.0, 1.0, 1.0) == pytest.approx(1.0, rel=1e-12)
    assert gap_closed(2.0, 3.0, 1.0) == pytest.approx(-5.0 / 3.0, rel=1e-12)
    assert gap_closed(1.05, 1.0, 1.0) is None
    assert gap_closed(3.0, 1.0, None) is None


def test_a_rise_is_exact_where_both_are_proportional_and_its_interval_covers_where_not() -> None:
    """Proportional samples give the ratio in every draw. Else 95 % of the intervals hold the true ratio of variances,
    here 1.5 in rms: 400 trials, 380 +- 4.4, and 30 groups are a little short of the level."""
    rng, group = np.random.default_rng(1), np.repeat(np.arange(30), 5)
    values = rng.standard_normal((150, 2))
    one = np.zeros_like(group)
    for rise, factor in zip(rise_with_interval(values * (1.25, 0.5), values, group, one), (1.25, 0.5), strict=True):
        assert (rise.value, rise.low, rise.high) == pytest.approx((factor - 1.0,) * 3, rel=1e-12)
    inside = 0
    for _ in range(400):
        less, more = rng.standard_normal((2, 150, 1))
        (rise,) = rise_with_interval(1.5 * more, less, group, one)
        inside += rise.low < 0.5 < rise.high
    assert 0.91 * 400 <= inside <= 0.98 * 400


def worth(residual: tuple[float, float, float], rollout: tuple[float, float, float]) -> Ablation:
    def rise(value: float, low: float, high: float) -> Rise:
        return Rise(value=value, low=low, high=high)

    return Ablation(
        residual={"specific_force.x": rise(-0.5, -0.6, -0.4), "specific_force.y": rise(*residual)},
        rollout={0.5: {"velocity": rise(*rollout)}, 1.0: {"velocity": rise(0.01, 0.0, 0.02)}},
        least=0.05,
        rivals=(),
    )


@pytest.mark.parametrize(("residual", "rollout", "material"), [
    ((0.08, 0.06, 0.1), (0.0, 0.0, 0.0), True),
    ((0.0, 0.0, 0.0), (0.08, 0.05, 0.1), True),
    ((0.03, 0.02, 0.04), (0.03, 0.02, 0.04), False),
    ((0.09, -0.16, 0.37), (0.0, 0.0, 0.0), None),
    ((0.02, -0.1, 0.2), (0.0, 0.0, 0.0), None),
])  # fmt: skip
def test_an_effect_is_material_if_the_interval_of_a_rise_shows_it(residual, rollout, material) -> None:
    result = worth(residual, rollout)
    assert result.material is material
    value, low, high = residual
    assert result.as_mapping()["residual"] == {"channel": "specific_force.y", "rises": value, "interval": [low, high]}


def test_the_note_of_an_effect_that_is_not_material_states_the_interval() -> None:
    def notes(material: Ablation) -> list[Finding]:
        return notes_on_materiality([make_named_effect("rotor_drag", ablation=material)])

    assert notes(worth((0.08, 0.06, 0.1), (0.0, 0.0, 0.0))) == []
    (note,) = notes(worth((0.09, -0.16, 0.37), (0.0, 0.0, 0.0)))
    assert (note.code, note.subject) == ("materiality_open", "rotor_drag")
    assert note.values == {"channel": "specific_force.y", "rise": 0.09, "rise_low": -0.16, "rise_high": 0.37}
    (note,) = notes(worth((0.03, 0.02, 0.04), (0.0, 0.0, 0.0)))
    assert (note.code, note.subject, note.values["least"]) == ("effect_immaterial", "rotor_drag", 0.05)


@pytest.mark.parametrize(("kind", "material", "expected"), [
    ("explained", (True, None), "explained"),
    ("explained", (None, False), "not shown"),
    ("ambiguous", (None,), "ambiguous"),
    ("none", (), "none"),
])  # fmt: skip
def test_effects_that_test_flights_do_not_show_explain_nothing(kind, material, expected) -> None:
    made = Decision(kind=kind, candidates=("rotor_drag",), findings=())
    assert decision_on_materiality(made, material).kind == expected


@pytest.mark.parametrize(
    ("octaves", "edge"),
    [((0.9, 0.5, 0.2, 0.01), 5.0), ((0.9, 0.01, 0.5, 0.5), 1.25), ((0.0, 0.9, 0.9, 0.9), None), ((0.1,) * 4, 10.0)],
)
def test_an_effect_is_solid_up_to_the_first_octave_that_it_leaves_as_it_is(octaves: tuple, edge: float | None) -> None:
    """5 % of the rms are 9.75 % of the power."""
    assert highest_reliable_frequency(octaves, 10.0, 0.05) == edge


@pytest.mark.parametrize(("log_odds", "wider", "because"), [
    (-3.5, False, Finding("rival_less_probable", "wind_shear", {"log_odds": -3.5})),
    (-3.5, True, Finding("rival_less_probable", "wind_shear", {"log_odds": -3.5})),
    (1.0, True, Finding("rival_wider", "wind_shear", {"effect": "constant_wind"})),
    (-2.5, False, Finding("rival_not_rejected", "wind_shear", {"effect": "constant_wind"})),
])  # fmt: skip
def test_why_a_rival_is_not_the_one_is_said(log_odds: float, wider: bool, because: Finding) -> None:
    rival = Rival(effect="wind_shear", fitted=make_fit("wind_shear"), log_odds=log_odds, wider=wider)
    assert reason_against_rival("constant_wind", rival) == because


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


def test_a_correction_that_worsens_a_channel_explains_nothing() -> None:
    good, bad = make_outcome("specific_force.x", -0.3, -0.4, -0.2), make_outcome("specific_force.z", 1.07, 0.3, 1.9)
    made = Decision(kind="explained", candidates=("constant_wind",), findings=(Finding("remains_near_floor"),))
    assert not good.is_materially_worse
    assert not make_outcome("x", 0.13, 0.04, 0.2).is_materially_worse
    assert bad.is_materially_worse
    assert decision_with_harm(made, []) is made
    harmed = decision_with_harm(made, [bad])
    assert (harmed.kind, harmed.candidates, harmed.findings) == ("unexplained", ("constant_wind",), ())
