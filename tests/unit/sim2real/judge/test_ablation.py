"""What effects are worth, and before and after in parts, against numbers that are known."""

import numpy as np
import pytest

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.select import Rival
from aerial_gym.sim2real.judge.ablation import Ablation, highest_reliable_frequency, reason_against_rival
from aerial_gym.sim2real.judge.evaluation import gap_closed
from aerial_gym.sim2real.judge.verdict import notes_on_materiality
from aerial_gym.sim2real.statistics import Rise, rise_with_interval
from tests.unit.sim2real.judge.builders import make_named_effect
from tests.unit.sim2real.set_fits import make_fit


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


@pytest.mark.parametrize(
    ("residual", "rollout", "material"),
    [
        ((0.08, 0.06, 0.1), (0.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), (0.08, 0.05, 0.1), True),
        ((0.03, 0.02, 0.04), (0.03, 0.02, 0.04), False),
        ((0.09, -0.16, 0.37), (0.0, 0.0, 0.0), None),
        ((0.02, -0.1, 0.2), (0.0, 0.0, 0.0), None),
    ],
)
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


@pytest.mark.parametrize(
    ("octaves", "edge"),
    [((0.9, 0.5, 0.2, 0.01), 5.0), ((0.9, 0.01, 0.5, 0.5), 1.25), ((0.0, 0.9, 0.9, 0.9), None), ((0.1,) * 4, 10.0)],
)
def test_an_effect_is_solid_up_to_the_first_octave_that_it_leaves_as_it_is(octaves: tuple, edge: float | None) -> None:
    """5 % of the rms are 9.75 % of the power."""
    assert highest_reliable_frequency(octaves, 10.0, 0.05) == edge


@pytest.mark.parametrize(
    ("log_odds", "wider", "because"),
    [
        (-3.5, False, Finding("rival_less_probable", "wind_shear", {"log_odds": -3.5})),
        (-3.5, True, Finding("rival_less_probable", "wind_shear", {"log_odds": -3.5})),
        (1.0, True, Finding("rival_wider", "wind_shear", {"effect": "constant_wind"})),
        (-2.5, False, Finding("rival_not_rejected", "wind_shear", {"effect": "constant_wind"})),
    ],
)
def test_why_a_rival_is_not_the_one_is_said(log_odds: float, wider: bool, because: Finding) -> None:
    rival = Rival(effect="wind_shear", fitted=make_fit("wind_shear"), log_odds=log_odds, wider=wider)
    assert reason_against_rival("constant_wind", rival) == because
