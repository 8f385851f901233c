"""Counts, quantities and numbers of runs in words."""

from joulemap.model.runs.words import count_words, number_words


def test_counts_of_logs_are_said_in_words():
    counts = {"gaps": 1, "stops": 24, "remainders": 34, "undriven": 1234, "fast": 0}
    assert count_words(counts) == (
        "1 gap, 24 stops, 34 pieces too short for a segment, 1,234 in runs in which the robot was carried"
    )
    repairs = {"held_fixes": 2, "voltage_spikes": 1, "current_left_spikes": 3, "blank_current": 5, "held_current": 4}
    assert count_words(repairs) == (
        "2 repeated positions, 1 voltage spike, 3 current left spikes, 5 rows without current, "
        "4 rows that repeat a reading of current"
    )


def test_numbers_have_three_digits_and_no_exponent_for_thousands():
    said = [number_words(value) for value in (0.0, 0.04567, 348.2, 999.6, 1949.9, -38321.0, 1.23e5)]
    assert said == ["0", "0.0457", "348", "1,000", "1,950", "-38,300", "123,000"]
    assert [number_words(value, signed=True) for value in (1949.9, 3.0, -3.0)] == ["+1,950", "+3", "-3"]


def test_what_rounding_left_of_a_difference_is_nothing():
    assert [number_words(value) for value in (-1.05e-15, 0.0, 3e-9)] == ["0", "0", "3e-09"]
