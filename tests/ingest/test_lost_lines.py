"""What is said of lines of text logs that do not parse."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from dynmap_cli.ingest.text.carmen import read_carmen
from dynmap_cli.ingest.text.carmen_lines import fault_of
from dynmap_cli.ingest.text.lost_lines import fault_of_pose
from dynmap_cli.ingest.text.wean import read_wean

TIME = "1200000000.5 host 0.5"
FLASER = f"FLASER 4 1.00 2.00 3.00 4.00 0 0 0 0 0 0 {TIME}"
ODOM = f"ODOM 1 2 0.5 0 0 0 {TIME}"
RAW = f"RAWLASER1 0 -1.5 3.0 1.0 50 0.01 0 4 1.00 2.00 3.00 4.00 0 {TIME}"
GLOWING = f"RAWLASER3 0 -1.5 3.0 1.0 50 0.01 0 4 1.00 2.00 3.00 4.00 2 30 40 {TIME}"
ROBOT = f"ROBOTLASER1 0 -1.5 3.0 1.0 50 0.01 0 4 1.00 2.00 3.00 4.00 0 0 0 0 0 0 0 0 0 0 0 0 {TIME}"
LINES = [FLASER, ODOM, RAW, GLOWING, ROBOT]
ODD = [
    "nan",
    "inf",
    "x",
    "-5",
    "1e400",
    "0",
    "1_0",
    "\xff",
    "7",
    "1.2.3",
    "9" * 40,
    "1e9",
    ".",
    "--1",
    "\x1b[31m",
]


def lost_in(path, lines, read=read_carmen):
    path.write_bytes("".join(f"{line}\n" for line in lines).encode("latin-1"))
    return dict(read(path, path.name).dropped)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (FLASER.replace(" 4 ", " 5 ", 1), "5 readings announced, which takes 16 words; 15 found"),
        (FLASER[:20], "4 readings announced, which takes 15 words; 5 found"),
        ("FLASER", "1 words found, and word 2 is the count of readings"),
        (
            FLASER.replace(" 4 ", " four ", 1),
            "count of readings 'four'; whole numbers from 1 to 8388608 are allowed",
        ),
        (FLASER.replace("3.00", "3,00"), "reading 3 is '3,00'; decimal points, not commas, are allowed"),
        (FLASER.replace("3.00", "3.0.0"), "reading 3 is '3.0.0'; numbers are allowed"),
        (FLASER.replace("0 12", "1e9 12"), "pose with '1e9'; numbers from -1e+08 to 1e+08 are allowed"),
        (FLASER.replace("1200000000.5", "-1"), "time '-1'; seconds from 0 to 4611686018 are allowed"),
        (ODOM.replace(" host", ""), "9 words found, 10 are allowed"),
        (
            RAW.replace(" 4 ", " 3 ", 1),
            "3 readings announced, and behind them stands '4.00', not the count of remissions",
        ),
        (
            GLOWING.replace(" 2 30", " 3 30"),
            "4 readings and 3 remissions announced, which takes 20 words; 19 found",
        ),
        (RAW[:50], "4 readings announced, which takes 17 words; 12 found"),
        (
            RAW.replace("1.0 50", "99 50"),
            "4 readings from -1.5 rad on in steps of 99 rad; a sweep starts within 12.6 rad and turns, by at most as "
            "much",
        ),
        (
            ROBOT.replace("-1.5", "\x1b[31mred"),
            "start angle, field of view, resolution, range '\\x1b[31mred', '3.0', '1.0', '50'; numbers from -1e+08 to "
            "1e+08 are allowed",
        ),
    ],
)
def test_what_was_found_and_what_is_allowed_is_said(line, why, tmp_path):
    word = line.split()[0]
    lines = [FLASER, RAW, "", line, line]
    expected = f"{word} line that does not parse; the first is line 4 of a.log: {why}"
    assert lost_in(tmp_path / "a.log", lines) == {expected: 2}


@pytest.mark.parametrize("n_between", [0, 200])
def test_the_first_is_that_with_the_lowest_number_also_where_it_is_found_later(n_between, tmp_path):
    """Counts of words are looked at line by line, numbers many lines at a time."""
    odd = FLASER.replace("3.00", "oops")
    lost = lost_in(tmp_path / "a.log", [FLASER, odd, *[FLASER] * n_between, FLASER[:20], FLASER])
    assert lost == {
        "FLASER line that does not parse; the first is line 2 of a.log: reading 3 is 'oops'; numbers are allowed": 2
    }


def test_lines_with_null_bytes_have_a_number_too(tmp_path):
    lost = lost_in(tmp_path / "a.log", ["FLASER \0", "# remark", FLASER[:20]])
    assert any("line 3 of a.log" in reason for reason in lost)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("O 1 2 0.5", "3 numbers found, 4 are allowed"),
        ("O 1 x 0.5 9", "pose with 'x'; numbers from -1e+08 to 1e+08 are allowed"),
        ("O 1 2 0.5 nan", "time 'nan'; seconds from 0 to 4611686018 are allowed"),
        ("L 1 2 0.5 1 2 0.5 7 8 9", "9 numbers found, 187 are allowed"),
        ("L 1 2 0.5 1 2 0.5 7 y" + " 8" * 178 + " 9", "reading 2 is 'y'; numbers are allowed"),
    ],
)
def test_of_wean_lines_too(line, why, tmp_path):
    lost = lost_in(tmp_path / "w.log", ["O 1 2 0.5 9", line], read_wean)
    assert lost == {f"{line[0]} line that does not parse; the first is line 2 of w.log: {why}": 1}


@settings(max_examples=300)
@given(
    st.sampled_from(LINES),
    st.lists(
        st.tuples(st.integers(1, 40), st.sampled_from(["cut", "drop", "add", *ODD])), min_size=1, max_size=3
    ),
)
def test_every_line_that_does_not_parse_has_a_reason(tmp_path_factory, line, changes):
    words = line.split()
    for number, change in changes:
        place = number % len(words) or len(words) - 1
        if change == "cut":
            words = words[: max(place, 1)]
        elif change == "drop" and place:
            del words[place]
        elif change == "add":
            words.insert(place, "1.0")
        elif place:
            words[place] = change
    text = " ".join(words)
    lost = lost_in(tmp_path_factory.getbasetemp() / "a.log", [text])
    if lost:
        assert fault_of(text.encode("latin-1"))
    assert all(reason.isascii() and reason.isprintable() for reason in lost)


def test_a_refusal_says_each_loss_once(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(f"{FLASER}\n{FLASER[:20]}\n")
    with pytest.raises(LogError) as refused:
        read_recordings([path], IngestSettings(strict=True))
    assert str(refused.value).count("does not parse") == 1
    assert "is damaged; 1 x FLASER line that does not parse; the first is line 2 of a.log: " in str(
        refused.value
    )


def test_a_text_log_without_sweeps_is_not_told_of_messages(tmp_path):
    path = tmp_path / "a.log"
    path.write_text(f"{ODOM}\n")
    with pytest.raises(
        LogError, match="Record FLASER, RLASER, ROBOTLASER or RAWLASER lines, or pass another"
    ):
        read_recordings([path], IngestSettings())


def test_a_word_of_which_a_part_is_a_number_is_none():
    """Found by the corpus: a byte of a pose became a control character."""
    assert fault_of_pose([b"1.5", b"\x19.3"]).startswith("pose with '\\x19.3'")
