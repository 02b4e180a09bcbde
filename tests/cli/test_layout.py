"""The arrows between rooms, read from the source."""

import ast
import functools
from pathlib import Path

import dynmap_cli
from dynmap_cli.files import edits, known
from dynmap_cli.runs.floor_plan import STAGES

PACKAGE = Path(dynmap_cli.__file__).parent
ROOMS = {"ingest", "mapping", "segmentation", "clustering", "localization"}
SIDE_ROOMS = {"simulation", "evaluation", "export", "report", "planner", "history", "comparison"}


@functools.cache
def imports():
    """(file, first room of it, imported module) for every import, also those inside functions."""
    return tuple(found for path in sorted(PACKAGE.rglob("*.py")) for found in imports_of(path))


def imports_of(path):
    relative = path.relative_to(PACKAGE)
    room = relative.parts[0].removesuffix(".py")
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield str(relative), room, alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{relative}: relative import"
            yield str(relative), room, node.module


def to_rooms():
    """(file, room, imported room) for imports within the package."""
    for file, room, module in imports():
        parts = module.split(".")
        if parts[0] == "dynmap_cli" and len(parts) > 1:
            yield file, room, parts[1]


def test_rooms_do_not_import_one_another():
    wrong = [(f, to) for f, room, to in to_rooms() if room in ROOMS and to in (ROOMS | SIDE_ROOMS) - {room}]
    assert wrong == []


def test_rooms_know_nothing_of_commands_and_pipeline():
    above = {"cli", "commands", "runs"}
    inner = ROOMS | SIDE_ROOMS | {"scan_matching", "counting", "files", "domain", "kernels"}
    assert [(f, to) for f, room, to in to_rooms() if room in inner and to in above] == []


def test_what_all_share_imports_no_room():
    allowed = {
        "scan_matching": {"scan_matching", "counting", "files", "domain", "kernels", "arrays", "progress"},
        "counting": {"counting", "domain", "kernels", "arrays", "errors", "progress"},
        "files": {"files", "domain", "arrays", "errors", "printable"},
        "domain": {"domain", "arrays"},
        "kernels": {"kernels", "arrays"},
    }
    assert [(f, to) for f, room, to in to_rooms() if room in allowed and to not in allowed[room]] == []


def test_arrows_between_the_rooms_of_ingest():
    """Recordings come in by containers and text, and are decided on once they are raw."""
    below = {
        "raw": set(),
        "messages": {"raw"},
        "text": {"raw", "messages"},
        "containers": {"raw", "messages", "text"},
        "seen_motion": {"raw"},
        "choices": {"raw", "seen_motion"},
    }
    wrong = []
    for file, _, module in imports():
        above, to = Path(file).parts[:2], module.split(".")[1:3]
        if above[0] == "ingest" and to[:1] == ["ingest"] and above[1] in below and to[1] in below:
            wrong += [(file, to[1])] if to[1] not in below[above[1]] | {above[1]} else []
    assert wrong == []


def test_only_kernels_import_numba_and_they_import_only_arithmetic():
    numba = {f for f, _, module in imports() if module.partition(".")[0] == "numba"}
    assert numba == {"kernels/jit.py"}
    outside = {m.partition(".")[0] for _, room, m in imports() if room == "kernels"} - {"dynmap_cli"}
    assert outside <= {
        "__future__",
        "collections",
        "hashlib",
        "math",
        "numba",
        "numpy",
        "os",
        "pathlib",
        "typing",
    }


def test_every_stage_reads_what_an_earlier_one_wrote():
    made = {f"{known.FOLDER}/"}  # by an update or edit
    for stage in STAGES:
        by_hand = {edits.NAME}
        assert set(stage.reads) - by_hand <= {f"{path.split('/')[0]}/" for path in made}, stage.name
        made |= set(stage.writes)


def test_a_finished_run_holds_what_the_stages_say(made):
    for stage in STAGES:
        for path in stage.writes:
            assert (made.run_dir / path).exists(), f"{stage.name}: {path}"
