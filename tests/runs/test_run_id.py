"""Names of runs are harmless as names of folders."""

import pytest

from mobo_tuner.runs.run_id import check_run_id, new_run_id


@pytest.mark.parametrize("run_id", ["a", "20261124-101500-awa", "A.b_c-1", "x" * 100])
def test_a_plain_name_is_kept(run_id: str) -> None:
    assert check_run_id(run_id) == run_id


@pytest.mark.parametrize(
    "run_id",
    ["", ".", "..", "../x", "a/b", "/etc", ".hidden", "-rf", "a b", "a\n", "ü", "a\0", "x" * 101],
)
def test_what_could_lead_elsewhere_is_refused_in_one_sentence(run_id: str) -> None:
    with pytest.raises(ValueError, match="run_id is ") as caught:
        check_run_id(run_id)
    assert len(str(caught.value).splitlines()) == 1


def test_new_names_are_allowed_and_differ() -> None:
    names = {check_run_id(new_run_id("awa")) for _ in range(50)}
    assert len(names) == 50
