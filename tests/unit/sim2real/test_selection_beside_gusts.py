"""The selection of a loop where gusts alone explain the training flights."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from aerial_gym.sim2real import loop
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.progress import silent
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection


@pytest.mark.parametrize(("sufficient", "named"), [(False, ("com_offset",)), (True, ())])
def test_no_effect_is_selected_beside_gusts_that_suffice(sufficient, named, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the flights cannot show, and what was looked for, are stated as before."""
    unseen, asked = {"ceiling_effect": Finding("logs_lack", "ceiling_effect")}, ("com_offset", "ceiling_effect")

    def select(*_, candidates, **__):
        if not candidates:
            return replace(make_selection(), looked_for=())
        return replace(make_selection(make_choice(make_fit("com_offset"))), not_testable=unseen, looked_for=candidates)

    monkeypatch.setattr(loop, "select_effects", select)
    monkeypatch.setattr(loop, "are_gusts_sufficient", lambda *_: sufficient)
    setup = SimpleNamespace(train=None, params=None, test=SimpleNamespace(flights=()))
    result = loop._selection_beside_gusts(setup, Criteria(), asked, silent)
    assert (result.effect_names, result.not_testable, result.looked_for) == (named, unseen, asked)
