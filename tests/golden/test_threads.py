"""Same input and seed, same bytes, on any number of threads."""

import json

import pytest

from tests.golden.corridor import dynmap


@pytest.fixture(scope="module")
def on_one_thread(corridor, sample_logs, tmp_path_factory):
    """The same as `corridor`, which used two."""
    folder = tmp_path_factory.mktemp("one_thread")
    logs = [sample_logs / f"corridor_{day}.mcap" for day in ("monday", "tuesday")]
    dynmap("build", logs[0], "-o", folder / "run", "--threads", 1, "-q")
    dynmap("localize", folder / "run", logs[1], "-o", folder / "out", "--threads", 1, "-q")
    return folder


@pytest.mark.parametrize("part", ["run", "out"])
def test_every_file_is_the_same_on_one_and_on_two_threads(corridor, on_one_thread, part):
    one, two = contents(on_one_thread / part), contents(corridor.run_dir.parent / part)
    assert sorted(one) == sorted(two)
    assert [name for name in one if one[name] != two[name]] == []
    assert len(one) > 10


def contents(folder):
    """File -> bytes; of manifests all but the seconds that the work took."""
    found = {}
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        content = path.read_bytes()
        if path.name.endswith(".manifest.json"):
            content = {**json.loads(content), "seconds": None}
        found[path.relative_to(folder).as_posix()] = content
    return found
