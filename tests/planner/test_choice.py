"""Which state is painted: against plain loops over the visits, and what the words say."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.patches import Visit
from dynmap_cli.planner.choice import StateRule, choose_states, parse_rule

S = 10**9
START_NS = 1_772_438_400 * S


def visits_of(states):
    """A visit of 5 s each 30 s; None where no state was recognised."""
    return [
        Visit(
            3,
            k,
            "a.mcap",
            START_NS + 30 * k * S,
            START_NS + (30 * k + 5) * S,
            state,
            math.nan if state is None else 0.9,
            "" if state is not None else "saw the change",
        )
        for k, state in enumerate(states)
    ]


SEEN = st.lists(st.one_of(st.none(), st.integers(0, 3)), max_size=12)


@given(SEEN)
def test_latest_is_the_last_state_that_was_recognised(states):
    known = [state for state in states if state is not None]
    assert choose_states(StateRule("latest"), visits_of(states)).states == tuple(known[-1:])


@given(SEEN, st.integers(-10, 400))
def test_at_a_time_is_latest_of_what_had_begun_by_then(states, second):
    begun = visits_of(states)[: max(second // 30 + 1, 0)]
    rule = StateRule("at", START_NS + second * S)
    assert choose_states(rule, visits_of(states)).states == choose_states(StateRule("latest"), begun).states


@given(SEEN)
def test_the_most_likely_state_was_seen_most_often_and_of_equals_last(states):
    known = [state for state in states if state is not None]
    choice = choose_states(StateRule("most-likely"), visits_of(states))
    if known:
        most = max(map(known.count, known))
        last = [state for state in known if known.count(state) == most][-1]
        assert choice.states == (last,)
        assert f"seen in {most} of {len(known)} visit" in choice.why
    else:
        assert choice.states == ()


@given(SEEN, st.randoms())
def test_the_order_of_the_rows_does_not_matter(states, random):
    visits = visits_of(states)
    shuffled = random.sample(visits, len(visits))
    for kind in ("latest", "most-likely", "open", "union"):
        assert choose_states(StateRule(kind), shuffled) == choose_states(StateRule(kind), visits)


def test_the_reason_says_when_it_was_seen_and_what_came_after():
    choice = choose_states(StateRule("latest"), visits_of([0, 1, None]))
    assert choice.seen_ns == START_NS + 35 * S
    assert choice.why == "last seen 2026-03-02T08:00:35Z in a.mcap; 1 visit after it recognised none"
    tie = choose_states(StateRule("most-likely"), visits_of([0, 1]))
    assert "as often as state 0, but seen later" in tie.why
    early = choose_states(StateRule("at", START_NS + 10 * S), visits_of([None, 1]))
    assert early.states == ()
    assert early.why == "no state known by then, first seen 2026-03-02T08:00:30Z"
    both = choose_states(StateRule("open"), visits_of([2, None, 0]))
    assert both.states == (0, 2)
    assert "seen in 2 visits from 2026-03-02T08:00:00Z to 2026-03-02T08:01:05Z" in both.why


def test_rules_are_read_as_they_are_written():
    for kind in ("latest", "most-likely", "open", "union"):
        assert parse_rule(kind) == StateRule(kind)
    for text in ("at=1772438400", "at=1772438400.0", "at=2026-03-02T08:00:00Z", "at=2026-03-02T09:00+01:00"):
        assert parse_rule(text) == StateRule("at", START_NS)
    assert parse_rule("at=20260302T080000Z") == parse_rule("at=2026-03-02T08:00") == StateRule("at", START_NS)
    assert parse_rule("at=20260302") == parse_rule("at=2026-03-02")
    assert parse_rule("at=20261399") == StateRule("at", 20261399 * 10**9)


@pytest.mark.parametrize(
    "text", ["", "newest", "at", "at=", "at=noon", "at=nan", "at=1e400", "latest=3", "at=2026-13-01"]
)
def test_other_words_are_refused(text):
    with pytest.raises(ValueError, match=r"latest, most-likely|ISO 8601"):
        parse_rule(text)
