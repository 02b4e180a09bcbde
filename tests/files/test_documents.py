import pytest

from dynmap_cli.files.documents import parse_json, parse_yaml, read_text


def test_plain_values_are_read():
    content = parse_yaml("a: [1, 2.5, true, null, word]\nb: {c: 0x10}\n")
    assert content == {"a": [1, 2.5, True, None, "word"], "b": {"c": 16}}
    assert parse_json('{"a": [1, -2, 2.5, null]}') == {"a": [1, -2, 2.5, None]}


BILLION = "a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BILLION, "anchors and aliases"),
        ("a: &a 1\n", "anchors and aliases"),
        ("a: 1\na: 2\n", "the key 'a' is there twice, line 2"),
        ("a: [1\n", "not YAML"),
        ("a: 2020-13-45\n", "month"),
        (f"a: {'9' * 30}\n", "beyond 64 bits"),
        (f"a: 0x{'f' * 5000}\n", "beyond 64 bits"),
        (f"a: {'9' * 5000}\n", "digits"),
        (f"a: {'1:' * 3000}1\n", "beyond 64 bits"),
        ("[" * 5000, "nested too deeply"),
        ("a: !!python/object:os.system {}\n", "could not determine a constructor"),
        ("? [a, b]\n: 1\n", "unhashable"),
        ("? {a: b}\n: 1\n", "unhashable"),
        ('a: "\\ud800"\n', "half a character"),
        ('"\\udcff": 1\n', "half a character"),
        ("a\0b: 1", "special characters"),
        ("--- 1\n--- 2\n", "single document"),
        ("!!int a", "."),
        ("!!float [a]", "."),
        ("!!timestamp x", "."),
        ("!!binary x", "."),
        ("!!omap [1]", "."),
        ("<<: 3\n", "."),
    ],
)
def test_what_is_not_plain_yaml_is_one_line(text, words):
    with pytest.raises(ValueError, match=words) as caught:
        parse_yaml(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("text", ["", "{", "[" * 200_000, "9" * 400, "-" + "9" * 5000, "[1,]", "nul"])
def test_what_is_not_plain_json_is_one_line(text):
    with pytest.raises(ValueError, match=r".+"):
        parse_json(text)


def test_a_text_is_read_only_up_to_its_most(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_text(path, 5) == "12345"
    with pytest.raises(ValueError, match="more than 4 bytes"):
        read_text(path, 4)
    path.write_bytes(b"\xff")
    with pytest.raises(ValueError, match="not text in UTF-8, byte 0 is 0xff"):
        read_text(path)
