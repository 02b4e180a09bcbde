"""Times for people: what is written is read back; clocks without a date stay seconds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.times import parse_iso, readable_time


@given(st.integers(100_000_000, 9_000_000_000))
def test_a_dated_stamp_comes_back(seconds):
    text = readable_time(seconds * 10**9 + 999_999_999)
    assert text.endswith("Z")
    assert parse_iso(text) == seconds * 10**9


def test_a_clock_without_a_date_stays_seconds():
    assert readable_time(12_340_000_000) == "12.3 s"
    assert readable_time(-5_000_000_000) == "-5.0 s"


def test_zones_are_understood_and_none_is_utc():
    times = ("2026-03-02T08:00:00Z", "2026-03-02T08:00:00", "2026-03-02T09:00:00+01:00", "2026-03-02 08:00")
    assert {parse_iso(text) for text in times} == {1_772_438_400_000_000_000}
    assert parse_iso("2026-03-02T08:00:00.25Z") == 1_772_438_400_250_000_000
    with pytest.raises(ValueError, match="yesterday"):
        parse_iso("yesterday")
