"""What a constant decides: it is changed wherever the loop has it from its place, and put back."""

import pytest

from aerial_gym.sim2real.identify import learned
from aerial_gym.sim2real.identify.candidates import structure
from aerial_gym.sim2real.identify.selection import scoring, select
from benchmarks.scores.constants import CASES, CONSTANTS, Answer, line, multiplied, row


def test_a_constant_is_changed_where_it_is_used_and_put_back() -> None:
    with multiplied("selection.scoring.LEAST_SCORE", 2.0) as usual:
        assert scoring.LEAST_SCORE == select.LEAST_SCORE == 2.0 * usual
    assert scoring.LEAST_SCORE == select.LEAST_SCORE == usual


def test_another_of_the_same_name_is_left_alone() -> None:
    other = learned.LEAST_SHARE
    with multiplied("candidates.structure.LEAST_SHARE", 0.5) as usual:
        assert 0.5 * usual == structure.LEAST_SHARE
        assert other == learned.LEAST_SHARE


@pytest.mark.parametrize("place", CONSTANTS)
def test_all_are_there_and_stay_what_they_are(place: str) -> None:
    with multiplied(place, 2.0) as usual:
        assert usual > 0


def test_a_row_says_which_cases_change() -> None:
    before = [Answer(verdict="explained", named=("rotor_drag",))] * len(CASES)
    lost = [*before[:1], Answer(verdict="none", named=()), *before[2:]]
    found = row("selection.scoring.LEAST_SCORE", 3.0, before, {0.5: before, 2.0: lost})
    assert line(found) == "| `selection.scoring.LEAST_SCORE` | 3 | the same | com_offset: nothing (`none`) |"
