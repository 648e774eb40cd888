"""Which sets are fitted on the way to the most probable one, with fits that are given."""

from dataclasses import replace
from typing import Any, cast

import pytest

from aerial_gym.sim2real.identify.selection.climb import FAR_BEHIND, View, reach_of
from tests.unit.sim2real.fitted_sets import Made, fitted


@pytest.mark.parametrize(("ahead", "tried"), [(1.0, True), (-1.0, False)])
def test_of_a_set_that_cannot_come_near_the_best_no_part_is_fitted(ahead: float, tried: bool) -> None:
    """It does not hold; what it could have at most is just beside odds of 1e-4 against the best."""
    best, drag = fitted("com_offset", overdispersion=4.0), fitted("rotor_drag", log=-1e3)
    least = best.log_posterior - FAR_BEHIND * reach_of(best)
    both = fitted("rotor_drag", "motor_tilt", log=-1e3, odds={"motor_tilt": -1.0})
    nothing = cast("Any", None)
    view = View(
        present=best,
        fits={best.label: best},
        own={},
        fresh=set(),
        fitter=Made(drag),
        library=nothing,
        structures=[],
        sets=nothing,
        guard=nothing,
    )
    view.add(replace(both, most=least + ahead))
    assert both.label in view.fits
    assert (drag.label in view.fits) == tried
