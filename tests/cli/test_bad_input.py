"""Bad input: one clear line, the right exit code, and every earlier result as it was."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.conftest import run_dynmap
from tests.ingest.corpus import FOLDERS

SETTINGS, RECORDING, FILES = 3, 4, 5


@pytest.fixture
def refused(small, unharmed):
    """Run a command that has to fail with one line; returns that line."""

    def check(code, *words):
        before = unharmed(small.run_dir)
        result = run_dynmap(*words)
        assert result.exit_code == code, result.output
        assert result.stdout == ""
        lines = [line for line in result.stderr.splitlines() if line.startswith("dynmap: ")]
        assert len(lines) == 1
        assert result.stderr.splitlines()[-1] == lines[0]
        assert "Traceback" not in result.stderr
        assert unharmed(small.run_dir) == before
        return lines[0]

    return check


def test_a_missing_recording(refused, small, tmp_path):
    for out in (small.run_dir, tmp_path / "new"):
        line = refused(RECORDING, "build", tmp_path / "gone.bag", "-o", out, "-q")
        assert "gone.bag: no such file" in line
    assert not (tmp_path / "new").exists()


def test_a_recording_that_is_passed_twice_to_a_finished_run(refused, small):
    line = refused(RECORDING, "build", small.recording, small.recording, "-o", small.run_dir, "-q")
    assert "the same recording. Pass it once" in line


@pytest.mark.parametrize("verb", [("build",), ("ingest",)])
def test_an_empty_recording(refused, small, tmp_path, verb):
    empty = tmp_path / "empty.mcap"
    empty.touch()
    assert "empty.mcap" in refused(RECORDING, *verb, empty, "-o", small.run_dir, "--force", "-q")


def test_a_run_in_the_place_of_a_recording(refused, small, tmp_path):
    line = refused(RECORDING, "build", small.run_dir, "-o", tmp_path / "out", "-q")
    assert f"{small.run_dir}: a run directory, which dynmap made of recordings, and none itself" in line


def test_a_folder_without_recordings(refused, small, tmp_path):
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "notes.txt").write_text("nothing here\n")
    assert "logs" in refused(RECORDING, "build", tmp_path / "logs", "-o", small.run_dir, "--force", "-q")


@pytest.mark.real
def test_a_bag_of_2008(refused, small, real_data):
    bag = real_data / "broken" / "rosrecord_v1.2.bag"
    assert "rosrecord_v1.2.bag" in refused(RECORDING, "build", bag, "-o", small.run_dir, "--force", "-q")


def test_a_recording_without_a_laser(refused, small, tmp_path):
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    text = store.types["std_msgs/msg/String"]
    with Writer(tmp_path / "talk.bag") as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, store.serialize_ros1(text(data="hello"), "std_msgs/msg/String"))
    line = refused(RECORDING, "build", tmp_path / "talk.bag", "-o", small.run_dir, "--force", "-q")
    assert "talk.bag" in line
    assert "laser" in line.lower()


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_truncated_recording_is_used_as_far_as_it_goes(small, tmp_path, kind):
    whole = tmp_path / f"whole.{kind}"
    scenario = small.recording.parent / "room.yaml"
    assert run_dynmap("simulate", scenario, "-o", whole, "-q").exit_code == 0
    short = tmp_path / f"short.{kind}"
    short.write_bytes(whole.read_bytes()[: whole.stat().st_size * 3 // 5])
    result = run_dynmap("ingest", short, "-o", tmp_path / "new")
    assert result.exit_code == 0, result.output
    lines = [line for line in result.stderr.splitlines() if "cut off or damaged" in line]
    assert len(lines) == 1
    assert "recovered" in lines[0]


def test_a_recording_of_which_nothing_is_left(refused, small, tmp_path):
    short = tmp_path / "short.mcap"
    short.write_bytes(small.recording.read_bytes()[:200])
    assert "short.mcap" in refused(RECORDING, "build", short, "-o", small.run_dir, "--force", "-q")


def test_an_unknown_setting_names_the_nearest(refused, small, tmp_path):
    settings = tmp_path / "robot.yaml"
    settings.write_text("map:\n  resolution: 0.1\n")
    for words in (("--config", settings), ("--set", "map.resolution=0.1")):
        line = refused(SETTINGS, "map", small.run_dir, *words, "-q")
        assert "did you mean 'resolution_m'?" in line


@pytest.mark.parametrize(
    "setting",
    [
        "map.static_prior=0.4",
        "map.resolution_m=wide",
        "seed=-1",
        "map.resolution_m=[1",
        "nonsense",
        "map.resolution_m=1e-9",
        "map.resolution_m=1e9",
        "map.usable_range_m=.inf",
        "localization.start=[.nan, 0, 0]",
        "localization.max_particles=1000000000000",
        "ingest.laser_pose=[1000, 0, 0]",
        "seed=99999999999999999999",
        "segmentation.window_s=1.0e-300",
        "map.em=2020-13-45",
        "map.em=&a [*a]",
        "map.resolution_m=true",
        "localization.start=[0, 0, false]",
    ],
)
def test_a_setting_that_is_not_allowed(refused, small, setting):
    refused(SETTINGS, "map", small.run_dir, "--set", setting, "-q")


def test_a_settings_file_that_is_not_there_or_not_settings(refused, small, tmp_path):
    refused(SETTINGS, "map", small.run_dir, "--config", tmp_path / "gone.yaml", "-q")
    for content in ("- a list\n", "map: 3\n", "map: {resolution_m: [}\n"):
        (tmp_path / "bad.yaml").write_text(content)
        assert "bad.yaml" in refused(SETTINGS, "map", small.run_dir, "--config", tmp_path / "bad.yaml", "-q")
    (tmp_path / "bad.yaml").write_bytes(b"\x7fELF\x02\xd0")
    line = refused(SETTINGS, "map", small.run_dir, "--config", tmp_path / "bad.yaml", "-q")
    assert "bad.yaml: settings cannot be read (it is not text in UTF-8, byte 5 is 0xd0)" in line


@pytest.mark.parametrize("content", ['"\\e[31mred": 3\n', 'map: {"a\\nb": 3}\n', 'amcl: {"\\e[31mred": 3}\n'])
def test_no_key_of_a_settings_file_commands_the_terminal(small, tmp_path, content):
    (tmp_path / "odd.yaml").write_text(content)
    said = run_dynmap("map", small.run_dir, "--config", tmp_path / "odd.yaml", "-q").stderr
    assert all(line.isprintable() for line in said.splitlines())


@pytest.mark.parametrize("verb", ["build", "map", "segment", "cluster", "localize"])
def test_a_run_of_another_format_version(refused, small, tmp_path, verb):
    for path in small.run_dir.rglob("*.manifest.json"):
        path.write_text(json.dumps({**json.loads(path.read_text()), "format_version": 99}))
    line = refused(FILES, *words_of(verb, small, tmp_path))
    assert "version 99" in line
    assert "version 1" in line


@pytest.mark.parametrize("verb", ["build", "ingest"])
def test_an_output_that_cannot_be_written(refused, small, tmp_path, verb):
    (tmp_path / "taken").write_text("a file, not a folder")
    for out in (tmp_path / "taken", tmp_path / "taken" / "run"):
        assert "taken" in refused(FILES, verb, small.recording, "-o", out, "-q")
    assert (tmp_path / "taken").read_text() == "a file, not a folder"


def test_an_output_of_localize_that_cannot_be_written(refused, small, tmp_path):
    (tmp_path / "taken").write_text("a file, not a folder")
    refused(FILES, "localize", small.run_dir, small.recording, "-o", tmp_path / "taken" / "out", "-q")
    refused(
        FILES, "simulate", small.recording.parent / "room.yaml", "-o", tmp_path / "taken" / "x.mcap", "-q"
    )


@pytest.mark.parametrize("verb", ["localize", "compare"])
def test_an_output_that_lies_in_the_recording(refused, small, tmp_path, verb):
    folder = FOLDERS["folder db3"](tmp_path)
    before = sorted(folder.rglob("*"))
    text = refused(FILES, verb, small.run_dir, folder, "-o", folder / "out", "-q")
    assert "is, or lies in, the recording that is read" in text
    assert sorted(folder.rglob("*")) == before


def test_a_stage_folder_that_cannot_be_written(refused, small):
    shutil.rmtree(small.run_dir / "submaps")
    (small.run_dir / "submaps").write_text("a file, not a folder")
    assert "submaps" in refused(FILES, "segment", small.run_dir, "-q")


@pytest.mark.parametrize("content", ["", "{", "[]", '{"format_version": 1}', "\x00\xff"])
def test_a_damaged_manifest(refused, small, content):
    (small.run_dir / "map" / "map.manifest.json").write_text(content, encoding="latin-1")
    assert "map.manifest.json" in refused(FILES, "segment", small.run_dir, "-q")
    refused(FILES, "build", small.recording, "-o", small.run_dir, "-q")


@pytest.mark.parametrize(
    "name, verb",
    [
        ("scans/ranges_m.npy", "map"),
        ("scans/stamps_ns.npy", "segment"),
        ("map/reflectance.npz", "segment"),
        ("map/trajectory.tum", "cluster"),
        ("submaps/submaps.yaml", "cluster"),
        ("patches/patches.zip", "localize"),
        ("map/map.pgm", "localize"),
    ],
)
def test_a_damaged_file_between_stages(refused, small, tmp_path, name, verb):
    path = small.run_dir / name
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 0xFF
    for content in (b"", whole[: len(whole) // 2], bytes(flipped)):
        path.write_bytes(content)
        line = refused(FILES, *words_of(verb, small, tmp_path), "--force")
        assert path.name in line
        assert "again with --force" in line
    path.unlink()
    assert path.name in refused(FILES, *words_of(verb, small, tmp_path))


def test_build_makes_damaged_files_again(small, unharmed):
    before = unharmed(small.run_dir)
    (small.run_dir / "scans" / "ranges_m.npy").write_bytes(b"")
    (small.run_dir / "map" / "map.pgm").unlink()
    result = run_dynmap("build", small.recording, "-o", small.run_dir, "-q")
    assert result.exit_code == 0
    after = unharmed(small.run_dir)
    assert [name for name in before if before[name] != after[name] and "manifest" not in name] == []


def test_a_run_that_is_not_there(refused, small, tmp_path):
    for verb in ("map", "segment", "cluster", "localize"):
        assert "no such run" in refused(FILES, *words_of(verb, small, tmp_path, run_dir=tmp_path / "gone"))
    assert not (tmp_path / "gone").exists()


def test_a_run_without_scans(refused, small, tmp_path):
    (tmp_path / "empty").mkdir()
    for verb in ("map", "segment", "cluster"):
        assert "'ingest' is not done" in refused(FILES, verb, tmp_path / "empty", "-q")
    assert "is not done" in refused(FILES, "localize", tmp_path / "empty", small.recording, "-q")


def test_stages_whose_input_is_of_other_scans(refused, small, tmp_path):
    other, scenario = tmp_path / "other.mcap", small.recording.parent / "room.yaml"
    for words in (("simulate", scenario, "-o", other, "--seed", 4), ("ingest", other, "-o", small.run_dir)):
        assert run_dynmap(*words, "--force", "-q").exit_code == 0
    for verb in ("segment", "cluster", "localize"):
        line = refused(FILES, *words_of(verb, small, tmp_path))
        assert "map: made from another scans/" in line


def test_patches_of_another_map(refused, small, tmp_path):
    assert run_dynmap("map", small.run_dir, "--set", "map.resolution_m=0.1", "-q").exit_code == 0
    line = refused(FILES, *words_of("localize", small, tmp_path))
    assert "made from another map/" in line


def test_localizing_never_replaces_the_scans_of_a_run(refused, small):
    line = refused(FILES, "localize", small.run_dir, small.recording, "-o", small.run_dir, "-q")
    assert "is a run directory" in line


def test_maps_that_are_no_maps(refused, small, tmp_path):
    words = ("localize", small.recording, "-o", tmp_path / "out", "-q", "--map")
    assert "gone.yaml" in refused(FILES, *words, tmp_path / "gone.yaml")
    lost = tmp_path / "lost.yaml"
    lost.write_text("image: lost.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    assert "lost.pgm" in refused(FILES, *words, lost)
    (tmp_path / "lost.pgm").write_bytes(b"P5 nonsense")
    assert "lost.pgm" in refused(FILES, *words, lost)


@pytest.mark.parametrize(
    "words",
    [
        ("build",),
        ("build", "x.bag"),
        ("localize", "run"),
        ("nonsense",),
        ("map", "run", "--threads", "many"),
        ("build", "x.bag", "-o", "run", "--from", "nowhere"),
        ("build", "x.bag", "-o", "run", "--laser-pose", "1,2"),
        ("build", "x.bag", "-o", "run", "--laser-pose", "nan,0,0"),
        ("localize", "run", "x.bag", "--start", "0,inf,0"),
        ("localize", "run", "x.bag", "--start", "1_0,0,0"),
        ("build", "x.bag", "-o", "run", "--mask-sector", "1_0,20"),
        ("map", "run", "--threads", "1000000000"),
        ("map", "run", "--seed", "9" * 30),
    ],
)
def test_usage_is_exit_code_2(words):
    result = run_dynmap(*words)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "Error: " in result.stderr


def words_of(verb, small, tmp_path, run_dir=None):
    """A call of a verb with all that it needs."""
    run_dir = run_dir or small.run_dir
    return {
        "build": ("build", small.recording, "-o", run_dir, "-q"),
        "localize": ("localize", run_dir, small.recording, "-o", tmp_path / "out", "-q"),
    }.get(verb, (verb, run_dir, "-q"))


def test_names_that_the_terminal_cannot_show(small, tmp_path):
    """A name that is not UTF-8, and a terminal that only knows ASCII: written out, and the run is whole."""
    odd = tmp_path / os.fsdecode(b"caf\xe9 \xc3\xa9.mcap")
    shutil.copy(small.recording, odd)
    environment = {**os.environ, "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    dynmap = [sys.executable, "-m", "dynmap_cli"]
    for words in (("build", odd, "-o", tmp_path / "odd"), ("check", odd), ("check", f"{odd}.gone")):
        done = subprocess.run([*dynmap, *map(str, words)], capture_output=True, env=environment, check=False)
        assert done.returncode == (RECORDING if str(words[1]).endswith("gone") else 0), done.stderr
        assert b"Traceback" not in done.stderr
        assert b"caf" in done.stdout + done.stderr
    assert (tmp_path / "odd" / "report.html").read_text(encoding="utf-8").startswith("<!")
    assert run_dynmap("build", odd, "-o", tmp_path / "odd", "-q").exit_code == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize(
    "words", [["config", "show"], ["check", "--json"], ["--help"], ["localize", "--help"], ["--version"]]
)
def test_an_output_that_is_full(small, words):
    recording = [str(small.recording)] if words[0] == "check" else []
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "dynmap_cli", *words, *recording],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == FILES
    assert done.stderr.splitlines()[-1].startswith("dynmap: stdout: cannot be written")


@pytest.mark.parametrize("verb", ["localize", "update", "compare"])
def test_a_recording_in_the_place_of_the_run(small, tmp_path, verb, unharmed):
    before = unharmed(small.run_dir)
    swapped = run_dynmap(verb, small.recording, small.run_dir)
    assert swapped.exit_code == 2
    assert f"RUN comes first, `dynmap {verb} {small.run_dir} {small.recording}`" in swapped.stderr
    alone = run_dynmap(verb, small.recording, small.recording)
    assert alone.exit_code == 2
    assert f"{small.recording} is a file, not a run directory" in alone.stderr
    assert unharmed(small.run_dir) == before


def test_a_run_and_a_map_at_once(small, tmp_path):
    map_yaml, out = small.run_dir / "map" / "map.yaml", tmp_path / "out"
    both = run_dynmap("localize", small.run_dir, small.recording, "--map", map_yaml, "-o", out)
    assert both.exit_code == 2
    assert f"{small.run_dir} is a run directory, and --map is another map" in both.stderr
    assert not out.exists()


@pytest.mark.parametrize("verb", ["localize", "compare", "timeline"])
def test_a_folder_in_or_above_a_run_in_its_place(refused, small, verb):
    recordings = () if verb == "timeline" else (small.recording,)
    for wrong in (small.run_dir / "map", small.run_dir.parent):
        line = refused(FILES, verb, wrong, *recordings, "-q")
        assert line == f"dynmap: {wrong}: no run directory. Did you mean {small.run_dir}?"


@pytest.mark.parametrize("map_path", ["", "map/map.pgm"])
def test_what_is_no_map_is_refused_before_a_recording_is_read(refused, small, tmp_path, map_path):
    words = ("--map", small.run_dir / map_path, small.recording, "-o", tmp_path / "out", "-q")
    assert "not a readable map YAML" in refused(FILES, "localize", *words)
    assert not (tmp_path / "out" / "scans").exists()


def test_a_run_without_a_map_is_refused_before_a_recording_is_read(refused, small, tmp_path):
    shutil.rmtree(small.run_dir / "map")
    line = refused(FILES, "localize", small.run_dir, small.recording, "-o", tmp_path / "out", "-q")
    assert "stage 'map' is not done here" in line
    assert not (tmp_path / "out").exists()


def test_a_verb_that_is_spelt_wrongly():
    assert "No such command 'localise'. Did you mean 'localize'?" in run_dynmap("localise", "run").stderr
    assert run_dynmap("xyz").stderr.endswith("No such command 'xyz'.\n")


@pytest.mark.parametrize("closed", ["| head -c 0", ">&-"])
def test_an_output_that_nobody_reads(closed):
    call = f"sleep 1 | {sys.executable} -m dynmap_cli config show {closed}; exit ${{PIPESTATUS[1]}}"
    done = subprocess.run(["bash", "-c", call], capture_output=True, text=True, check=False)
    assert done.returncode == FILES
    assert [line[:34] for line in done.stderr.splitlines()] == ["dynmap: stdout: cannot be written "]
