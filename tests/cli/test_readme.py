"""What the README and the pages in docs/ show works."""

import json
import re
from pathlib import Path

from tests.bench.results import HEADLINES, rewrite_short_forms, short_rows
from tests.bench.tables import Table

PROJECT = Path(__file__).parents[2]
README = (PROJECT / "README.md").read_text(encoding="utf-8")
OUTPUTS = (PROJECT / "docs" / "outputs.md").read_text(encoding="utf-8")


def test_the_python_in_the_readme_reads_the_patches(corridor, capsys):
    (code,) = re.findall(r"```python\n(.*?)```", OUTPUTS, re.DOTALL)
    names: dict[str, object] = {}
    exec(code.replace("runs/site", str(corridor.run_dir)), names)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert len(names["visits"]) == 12


def test_every_file_of_a_run_is_in_the_table(corridor):
    for folder in (corridor.run_dir, corridor.out_dir):
        for path in folder.rglob("*"):
            name = path.name
            if path.is_dir() or name.endswith((".manifest.json", ".npy")) or name == ".lock":
                continue
            known = re.sub(r"_\d\b", "_N", re.sub(r"_\d{3}", "_NNN", name))
            assert known in OUTPUTS or path.parent.name in ("figures", "scans"), name


def test_columns_and_exit_codes_are_as_documented():
    from dynmap_cli.errors import ArtifactError, ConfigError, LogError
    from dynmap_cli.files.manifest import FORMAT_VERSION
    from dynmap_cli.localization.outputs import HEALTH_HEADER, STATES_HEADER

    assert f"`{STATES_HEADER}`" in OUTPUTS
    assert f"`{HEALTH_HEADER}`" in OUTPUTS
    assert f"**format version {FORMAT_VERSION}**" in OUTPUTS
    for kind, word in ((ConfigError, "setting"), (LogError, "recording"), (ArtifactError, "between stages")):
        assert re.search(rf"^\| {kind.exit_code} \| [^|]*{word}", README, re.MULTILINE)


def test_links_lead_somewhere():
    pages = [PROJECT / "README.md", *sorted((PROJECT / "docs").glob("*.md"))]
    for page in pages:
        text = page.read_text(encoding="utf-8")
        found = re.findall(r"\]\(([^)#:]*)#?([^):]*)\)|src=\"([^\"]+)\"", text)
        for link, place, picture in found:
            target = page.parent / (link or picture) if link or picture else page
            assert target.exists(), (page.name, link or picture)
            assert not place or place in anchors(target), (page.name, link, place)
    assert [page.name for page in pages[1:] if f"docs/{page.name}" not in README] == []


def anchors(page):
    """Places of a page that a link may name."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-") for heading in headings}


def test_measured_rows_of_the_readme_are_those_of_the_page_and_are_written_as_they_stand(tmp_path):
    every = short_rows(PROJECT / "docs" / "measured.md")
    shown = short_rows(PROJECT / "README.md")
    assert shown == [row for row in every if row[0] in HEADLINES]
    assert len(shown) == len(HEADLINES) < len(every)
    for folder in (tmp_path, tmp_path / "docs"):
        folder.mkdir(exist_ok=True)
    for name in ("README.md", "docs/measured.md"):
        (tmp_path / name).write_bytes((PROJECT / name).read_bytes())
    rewrite_short_forms(tmp_path, [Table("", [], [], short=every)])
    for name in ("README.md", "docs/measured.md"):
        assert (tmp_path / name).read_bytes() == (PROJECT / name).read_bytes()


def test_the_lines_of_the_terminal_are_those_that_are_printed(corridor):
    """But for numbers and why loops were rejected, which may differ a little on another machine."""

    def masked(line):
        return re.sub(r"-?\d+(\.\d+)?", "N", re.sub("rejected: .*", "rejected", line))

    built, localized = (
        [line for line in block.splitlines() if ": " in line]
        for block in re.findall(r"```text\n(.*?)```", README, re.DOTALL)
    )
    for shown, paths in (
        (built, [*corridor.run_dir.glob("*.manifest.json"), *corridor.run_dir.glob("*/*.manifest.json")]),
        (localized, [corridor.out_dir / "localize.manifest.json"]),
    ):
        printed = set()
        for path in paths:
            manifest = json.loads(path.read_text())
            printed |= {masked(f"{manifest['stage']}: {line}") for line in manifest["summary"]["lines"]}
        assert [line for line in shown if masked(line) not in printed] == []
        assert printed <= set(map(masked, shown))
