"""The table of the tests' CPU time."""

from __future__ import annotations

from tests.cpu_times import SLOWEST, lines


def test_the_table_has_the_sum_then_the_folders_then_the_slowest_tests_the_longest_first() -> None:
    seconds = {
        "tests/a/test_x.py::test_one": 0.5,
        "tests/b/test_y.py::test_two[/::3]": 2.0,
        "tests/a/test_x.py::test_three": 1.0,
    }
    assert [line.split() for line in lines(seconds)] == [
        ["3.50", "s", "3", "tests"],
        ["2.00", "s", "1", "tests", "in", "tests/b"],
        ["1.50", "s", "2", "tests", "in", "tests/a"],
        ["2.00", "s", "tests/b/test_y.py::test_two[/::3]"],
        ["1.00", "s", "tests/a/test_x.py::test_three"],
        ["0.50", "s", "tests/a/test_x.py::test_one"],
    ]
    many = {f"tests/test_z.py::test_{number}": 1.0 for number in range(100)}
    assert len(list(lines(many))) == 2 + SLOWEST
