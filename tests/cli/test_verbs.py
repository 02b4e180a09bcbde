"""What every verb promises: skipped when nothing changed, JSON alone on stdout, quiet or talkative stderr."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dynmap_cli.cli import VERBS
from tests.cli.conftest import run_dynmap

STAGES = ("ingest", "map", "segment", "cluster", "report")


def ran(*words):
    """Stage -> whether it ran, of a build."""
    result = run_dynmap("build", *words, "--json", "-q")
    assert result.exit_code == 0, result.output
    return {name: stage["ran"] for name, stage in json.loads(result.stdout)["stages"].items()}


def test_a_second_build_runs_nothing(small, unharmed):
    before = unharmed(small.run_dir)
    assert ran(small.recording, "-o", small.run_dir) == dict.fromkeys(STAGES, False)
    assert unharmed(small.run_dir) == before


def test_a_changed_setting_runs_its_stage_and_what_depends_on_it(small):
    words = (small.recording, "-o", small.run_dir, "--set", "segmentation.min_cells=7")
    assert ran(*words) == {"ingest": False, "map": False, "segment": True, "cluster": False, "report": False}
    words = (*words, "--set", "map.resolution_m=0.1")
    assert ran(*words) == {name: name != "ingest" for name in STAGES}


@pytest.mark.parametrize("first", STAGES)
def test_from_runs_a_stage_and_all_later_ones(small, first):
    expected = {name: STAGES.index(name) >= STAGES.index(first) for name in STAGES}
    assert ran(small.recording, "-o", small.run_dir, "--from", first) == expected


def test_force_runs_everything_and_changes_no_byte(small, unharmed):
    before = unharmed(small.run_dir)
    assert ran(small.recording, "-o", small.run_dir, "--force") == dict.fromkeys(STAGES, True)
    after = unharmed(small.run_dir)
    assert sorted(before) == sorted(after)
    assert [n for n in before if before[n] != after[n] and not n.endswith(".manifest.json")] == []


def test_the_stages_alone_are_the_same_as_build(small, tmp_path, unharmed):
    run_dir = tmp_path / "alone"
    assert run_dynmap("ingest", small.recording, "-o", run_dir, "-q").exit_code == 0
    for verb in ("map", "segment", "cluster"):
        assert run_dynmap(verb, run_dir, "-q").exit_code == 0
    alone, built = unharmed(run_dir), unharmed(small.run_dir)
    assert set(alone) < set(built)
    assert [n for n in alone if alone[n] != built[n] and not n.endswith(".manifest.json")] == []


def test_run_yaml_says_how_each_stage_was_run(small):
    import yaml

    assert run_dynmap("map", small.run_dir, "--set", "map.resolution_m=0.1", "-q").exit_code == 0
    assert run_dynmap("segment", small.run_dir, "--set", "segmentation.min_cells=7", "-q").exit_code == 0
    content = yaml.safe_load((small.run_dir / "run.yaml").read_text())
    assert content["settings"]["map"]["resolution_m"] == 0.1
    assert content["settings"]["segmentation"]["min_cells"] == 7
    assert list(content["recordings"]) == [str(small.recording)]
    assert len(content["recordings"][str(small.recording)]) == 64


def test_build_says_where_everything_is(small):
    words = run_dynmap("build", small.recording, "-o", small.run_dir).stdout.split()
    for name in ("map/map.yaml", "patches/patches.zip", "report.html", "figures"):
        path = small.run_dir / name
        assert any(word.rstrip("/") == str(path) for word in words)
        assert path.exists()


def test_json_stands_alone_on_stdout(small, tmp_path):
    scenario = small.recording.parent / "room.yaml"
    for words in (
        ("build", small.recording, "-o", small.run_dir, "--from", "segment"),
        ("ingest", small.recording, "-o", small.run_dir),
        ("map", small.run_dir),
        ("segment", small.run_dir),
        ("cluster", small.run_dir),
        ("localize", small.run_dir, small.recording, "-o", tmp_path / "out"),
        ("check", small.recording),
        ("simulate", scenario, "-o", tmp_path / "again.mcap"),
        ("config", "show"),
    ):
        result = run_dynmap(*words, "--json", "-v")
        assert result.exit_code == 0, result.output
        assert isinstance(json.loads(result.stdout, parse_constant=pytest.fail), dict)


def test_quiet_leaves_stderr_empty_and_logs_go_there_otherwise(small):
    words = ("map", small.run_dir, "--force")
    assert run_dynmap(*words, "-q").stderr == ""
    assert "map: finding path" in run_dynmap(*words).stderr


def test_numbers_that_json_does_not_know_become_null(capsys):
    from dynmap_cli.commands.options import print_summary

    print_summary({"a": float("nan"), "b": [1.5, float("inf")]}, [], as_json=True)
    assert json.loads(capsys.readouterr().out) == {"a": None, "b": [1.5, None], "warnings": []}


def test_localize_writes_below_the_run_by_default_and_is_skipped_the_second_time(small):
    words = ("localize", small.run_dir, small.recording, "--json", "-q")
    first, second = (json.loads(run_dynmap(*words).stdout) for _ in range(2))
    assert first == second
    out = small.run_dir / "localization" / "room"
    assert first["output"] == str(out)
    assert (out / "localization.png").samefile(first["picture"])
    stamp = (out / "localize.manifest.json").stat().st_mtime_ns
    assert run_dynmap(*words, "--seed", 5).exit_code == 0
    assert (out / "localize.manifest.json").stat().st_mtime_ns > stamp


def test_a_plain_map_is_localized_in_again_when_its_image_changed(small, tmp_path):
    for name in ("map.yaml", "map.pgm"):
        (tmp_path / name).write_bytes((small.run_dir / "map" / name).read_bytes())
    out = tmp_path / "out"
    words = ("localize", "--map", tmp_path / "map.yaml", small.recording, "-o", out)
    assert run_dynmap(*words).exit_code == 0
    assert "localize: up to date" in run_dynmap(*words).stderr
    image = bytearray((tmp_path / "map.pgm").read_bytes())
    image[-1] = 254 - image[-1] if image[-1] in (0, 254) else 254
    (tmp_path / "map.pgm").write_bytes(bytes(image))
    assert "localize: up to date" not in run_dynmap(*words).stderr


def test_a_run_whose_scans_were_taken_away_can_still_be_localized_in(small, tmp_path):
    import shutil

    shutil.rmtree(small.run_dir / "scans")
    words = ("localize", small.run_dir, small.recording, "-o", tmp_path / "out", "-q")
    assert run_dynmap(*words).exit_code == 0


def test_a_second_writer_is_refused_and_a_killed_one_leaves_no_lock(small, tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from dynmap_cli.files.lock import writing\n"
        "with writing(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    words = ("build", small.recording, "-o", small.run_dir, "-q")
    with subprocess.Popen(
        [sys.executable, "-c", code, str(small.run_dir)], stdout=subprocess.PIPE, text=True
    ) as holder:
        try:
            assert holder.stdout.readline() == "held\n"
            for refused, remedy in (
                (words, "Wait until it is done, or choose another output."),
                (("update", small.run_dir, small.recording, "-q"), "Wait until it is done."),
                (
                    ("localize", small.run_dir, small.recording, "-o", tmp_path / "out", "-q"),
                    "Wait until it is done.",
                ),
            ):
                result = run_dynmap(*refused)
                assert result.exit_code == 5
                assert result.stderr.endswith(f": another dynmap is working in this folder. {remedy}\n")
        finally:
            holder.kill()
            holder.wait()
    assert run_dynmap(*words).exit_code == 0


def test_readers_share_a_run(small):
    from dynmap_cli.errors import ArtifactError
    from dynmap_cli.files.lock import reading, writing

    with reading(small.run_dir), reading(small.run_dir), pytest.raises(ArtifactError), writing(small.run_dir):
        pass
    with writing(small.run_dir):
        pass


def test_an_interrupt_is_exit_code_130(small, monkeypatch):
    from dynmap_cli.runs import pipeline

    def interrupted(*_args, **_kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline, "run_one", interrupted)
    result = run_dynmap("map", small.run_dir)
    assert result.exit_code == 130
    assert result.stderr.startswith("dynmap: interrupted")


def test_help_imports_none_of_the_heavy_libraries():
    code = (
        "import sys\nfrom click.testing import CliRunner\nfrom dynmap_cli.cli import main\n"
        "assert CliRunner().invoke(main, ['--help']).exit_code == 0\n"
        "print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    heavy = {"numpy", "numba", "scipy", "pydantic", "yaml", "PIL", "matplotlib", "rosbags", "mcap", "tqdm"}
    assert not heavy & set(done.stdout.split())


def test_ingest_does_without_compiler_and_solvers(sample_logs, tmp_path):
    code = (
        "import sys\nfrom click.testing import CliRunner\nfrom dynmap_cli.cli import main\n"
        f"words = ['ingest', {str(sample_logs / 'corridor_monday.mcap')!r}, '-o', {str(tmp_path / 'run')!r}]\n"
        "assert CliRunner().invoke(main, words).exit_code == 0\n"
        "print(*sorted({'numba', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_and_is_in_the_readme(verb):
    result = run_dynmap(verb, "--help")
    assert result.exit_code == 0
    assert result.stdout.startswith("Usage:")
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert f"dynmap {verb}" in readme


def test_the_list_of_verbs_says_each_in_a_whole_sentence():
    lines = run_dynmap("--help").stdout.splitlines()
    for verb in VERBS:
        (line,) = (line for line in lines if re.match(rf"  {verb} +[A-Z]", line))
        assert line.endswith(".")
        assert not line.endswith("...")


def test_the_exit_codes_are_documented_and_distinct():
    from dynmap_cli.errors import ArtifactError, ConfigError, LogError

    text = run_dynmap("--help").stdout
    codes = [0, 1, 2, ConfigError.exit_code, LogError.exit_code, ArtifactError.exit_code, 130]
    assert len(set(codes)) == len(codes)
    assert all(re.search(rf"\n +{code}  \w", text) for code in codes)


def test_warmup_compiles_every_kernel_once():
    code = (
        "import importlib, pkgutil, sys\nfrom click.testing import CliRunner\nfrom dynmap_cli.cli import main\n"
        "result = CliRunner().invoke(main, ['warmup', '-q'])\nassert result.exit_code == 0, result.output\n"
        "import dynmap_cli.kernels as room\n"
        "for name, module in list(sys.modules.items()):\n"
        "    if name.startswith('dynmap_cli.') and not name.startswith('dynmap_cli.kernels'):\n"
        "        for kernel in vars(module).values():\n"
        "            if hasattr(kernel, 'signatures') and hasattr(kernel, 'py_func'):\n"
        "                print(kernel.__name__, len(kernel.signatures))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    counts = dict(line.split() for line in done.stdout.splitlines())
    assert len(counts) > 10
    assert {name: count for name, count in counts.items() if count != "1"} == {}


def test_the_readers_of_a_run_give_what_was_written(small):
    from dynmap_cli.files.counting_map import read_beams, read_counting_map
    from dynmap_cli.files.scan_log import read_scan_log
    from dynmap_cli.files.trajectory import read_tum

    log = read_scan_log(small.run_dir / "scans")
    beams = read_beams(small.run_dir / "map" / "beams.npz", (log.n_scans, log.n_beams))
    assert beams.shape == log.ranges_m.shape
    assert np.array_equal(read_tum(small.run_dir / "map" / "trajectory.tum").stamps_ns, log.stamps_ns)
    reflectance = read_counting_map(small.run_dir / "map" / "reflectance.npz").reflectance
    assert 0.5 < np.nanmax(reflectance) <= 1.0


def test_evaluating_in_another_frame_hints_at_the_map(small, tmp_path):
    truth, out = f"{small.recording}.truth", tmp_path / "out"
    assert run_dynmap("localize", small.run_dir, small.recording, "-o", out, "-q").exit_code == 0
    words = ("evaluate", "localization", out, truth)
    assert "pass --map RUN TRUTH" in run_dynmap(*words).stdout
    assert "pass --map RUN TRUTH" not in run_dynmap(*words, "--map", small.run_dir, truth).stdout
