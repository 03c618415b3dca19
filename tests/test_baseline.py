"""Mutants are found again however a file is changed around them; see baseline/README.md."""

from pathlib import Path

import mutants
import pytest

SOURCE = '''
"""Not a word of this: 1 < 2 and 3."""
STEP_M = 0.0


class Band:
    """Between two heights."""

    size: "tuple[int, 3]" = (1, 2)

    @cached(size=3)
    def holds(self, low: "Literal[1]" = True) -> "Literal[2]":
        """Whether 1 < 2."""
        if low <= self.size[0] < 7 and not (low == 2):  # above ° and below
            self.note(f"é {low + 1} < 3")
            return low - (2 * 3) is not None or low in (4,)
        é = max(np.minimum(low, 1.5), "a" + str(low))
        if low > 9:
            raise ValueError(f"{low} of {1 + 2}", 5)
        return None


def holds(low):
    self.note(low, 1)
    self.note(low, 1)
'''


@pytest.mark.parametrize("file", ["companion/band.py", "companion/path/strip.py"])
def test_it_is_found_again_where_it_was_moved_to(
    file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for a line that has changed."""
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    mutants.of_file.cache_clear()
    (tmp_path / file).parent.mkdir(parents=True)
    (tmp_path / file).write_text("import sys\n\n" + SOURCE.replace("9", "9.5"), encoding="utf-8")
    before, found = SOURCE.splitlines(), mutants.mutants_of(SOURCE.encode(), "companion/band.py")
    for each in found:
        after = each.applied(SOURCE.encode()).decode().splitlines()
        assert [a.strip() for a, b in zip(before, after, strict=True) if a != b] == [each.line]
        again = mutants.found_again(each._asdict())
        if "9" in each.line:
            assert again is None
        elif each.function == "Band.holds":
            assert (again.file, again.new, again.row) == (file, each.new, each.row + 2)
    assert len(found) > 20
    mutants.of_file.cache_clear()


def test_every_row_of_the_baseline_was_killed_by_tests_of_this_repository() -> None:
    entries = mutants.recorded()
    assert {entry["part"] for entry in entries} == set(mutants.PARTS)
    for entry in entries:
        assert {*mutants.Mutant._fields[:5]} < entry.keys()
        assert all(test.startswith("tests/") for test in entry["killers"])
