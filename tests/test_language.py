"""Language of names, docstrings and pages: each rule is one test that lists all offences. A rule that the tree does not
meet yet has its allowed offences in ``tests/language/debt.json``."""

import pytest

from tests.language import debt, names, pages
from tests.language.rules import RULES


@pytest.mark.parametrize("rule", RULES)
def test_language(rule: str) -> None:
    lines = debt.difference(RULES[rule](), debt.read().get(rule, {}))
    assert not lines, f"{rule}:\n" + "\n".join(lines)


@pytest.mark.parametrize(
    ("kind", "name", "fault"),
    [
        ("function", "told_in", "ends in a preposition"),
        ("function", "without_blind", ""),
        ("function", "said_first", "begins with a participle"),
        ("function", "_moving", "begins with a participle"),
        ("function", "heading_error", ""),
        ("function", "plainly_wrong", "begins with an adverb"),
        ("function", "apply_force", ""),
        ("function", "signed_distances", ""),
        ("function", "test_fitted_values_are_kept", ""),
        ("function", "test_a_body_is_looked_at", "ends in a preposition"),
        ("class", "FittedModel", "begins with a participle"),
        ("class", "RotorMixing", ""),
        ("module", "beside", "ends in a preposition"),
        ("module", "test_looks", ""),
        ("function", "with_everything", "contains a pronoun"),
        ("variable", "found", "is a pronoun"),
        ("variable", "found_joints", ""),
        ("parameter", "other", ""),
    ],
)
def test_fault_of_a_name(kind: str, name: str, fault: str) -> None:
    assert names.fault(kind, name) == fault


def test_sentences_and_tables_of_a_page() -> None:
    page = (
        "# A title\n\nOne two `code of one word`. Three [four five](x.md)\nsix!\n\n- seven eight nine\n- ten\n\n"
        "```\na b c d\n```\n| a b | c |\n"
    )
    assert [pages.count(part) for part in pages.sentences(page)] == [3, 4, 3]
    assert pages.mean_length(page) == pytest.approx(10 / 3)
    assert pages.table_share(page) == 3 / (2 + 3 + 4 + 3 + 1 + 3)


def test_anchors_and_targets_of_a_page() -> None:
    page = (
        "# A *step*: 1 - 2\n\n## Twice\n\n## Twice\n\n"
        "`[no](code.md)` [yes](a/b.md#c 'title') [far](https://example.org) <img src='p.png'>\n"
    )
    assert {"a-step-1---2", "a-step-1-2", "twice", "twice-1", "twice_1"} <= pages.anchors(page)
    assert pages.targets(page) == ["a/b.md#c", "p.png"]


def test_debt_may_only_fall() -> None:
    """More offences than allowed, fewer than allowed and offences in a file without debt fail; the allowed number passes."""
    offences = {"same": ["a"], "more": ["a", "b"], "new": ["a"]}
    lines = debt.difference(offences, {"same": 1, "more": 1, "fewer": 2})
    assert [line.partition(":")[0] for line in lines] == ["fewer", "more", "new"]
