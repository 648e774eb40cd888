"""A short run of the fuzzers: no kind of input may end in a traceback. ``make fuzz`` runs thousands."""

import pytest

from benchmarks.robustness.fuzz.__main__ import Fuzz


def test_a_few_mutated_inputs_of_each_kind_work_or_are_refused(tmp_path, capsys) -> None:
    pytest.importorskip("yourdfpy")
    status = Fuzz(count=88, seed=7, out=tmp_path).run()
    assert status == 0, capsys.readouterr().out
