"""The budget of the code counts code, names what is exceeded, and never rises."""

from __future__ import annotations

import tomllib

from tests.budget import code_lines, lowered, report, wide_functions

SOURCE = '''"""A docstring
of two lines."""

# a comment
TEXT = """a string
of two lines"""  # which is code


def few(self, a, b, c, d, e, f, g, h):
    """One."""
    return a


def many(a, b, c, d, e, *, f, g, h, i):
    return a
'''


def test_lines_of_code_are_without_comments_docstrings_and_blank_lines() -> None:
    assert code_lines(SOURCE) == 6


def test_self_is_no_argument() -> None:
    assert wide_functions(SOURCE) == 1


def test_what_is_exceeded_is_said() -> None:
    limits = {"model": {"code_lines": 10}}
    assert report({"model": {"code_lines": 10}}, limits)[1] == []
    assert report({"model": {"code_lines": 12}}, limits)[1] == ["model: 12 code lines, and the limit is 10: remove 2"]


def test_limits_only_fall() -> None:
    text = lowered({"model": {"code_lines": 12, "all_lines": 20}}, {"model": {"code_lines": 10, "all_lines": 30}})
    assert tomllib.loads(text) == {"model": {"code_lines": 10, "all_lines": 20}}
