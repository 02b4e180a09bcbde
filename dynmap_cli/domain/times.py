"""Times as people write them: ISO 8601 in UTC, or plain seconds where a clock never knew the date."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

_DATED_FROM_NS = 100_000_000 * 10**9
_HOUR_NS, DAY_HOURS = 3600 * 10**9, 24
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def readable_time(stamp_ns: int) -> str:
    """Name a stamp to the second; before March 1973 it is the count of a clock that was never set."""
    if stamp_ns < _DATED_FROM_NS:
        return f"{stamp_ns * 1e-9:.1f} s"
    return (_EPOCH + timedelta(seconds=stamp_ns // 10**9)).strftime("%Y-%m-%dT%H:%M:%SZ")


def hours_of(stamp_ns: int) -> float | None:
    """Time of day in UTC, hours from 0 to 24; None for a clock that was never set."""
    return None if stamp_ns < _DATED_FROM_NS else stamp_ns % (DAY_HOURS * _HOUR_NS) / _HOUR_NS


def day_of(stamp_ns: int) -> int:
    """Number of the day in UTC."""
    return stamp_ns // (DAY_HOURS * _HOUR_NS)


def parse_iso(text: str) -> int:
    """Nanoseconds since the epoch of an ISO 8601 time; one without a zone is UTC.

    Raises
    ------
    ValueError
        If the text is no such time.
    """
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
