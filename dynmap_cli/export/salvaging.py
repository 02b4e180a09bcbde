"""What can be read of damaged recordings, written as a whole one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dynmap_cli.errors import ArtifactError
from dynmap_cli.export.mcap_copy import McapCopy
from dynmap_cli.export.messages import in_order, open_container
from dynmap_cli.export.sources import copy_sources
from dynmap_cli.files.atomic import replacing
from dynmap_cli.ingest.containers.mcap_records import NOT_COPIED
from dynmap_cli.ingest.containers.opening import Source
from dynmap_cli.ingest.settings import IngestSettings

_TEXT_KINDS = {"carmen", "wean"}


@dataclass(slots=True)
class Salvaged:
    """What was written.

    Attributes
    ----------
    out_path : Path
    messages : Counter
        By topic.
    losses : list of str
        What was lost, one sentence for each damaged file.
    """

    out_path: Path
    messages: Counter[str] = field(default_factory=Counter)
    losses: list[str] = field(default_factory=list)

    def summary(self) -> dict[str, Any]:
        """For programs."""
        return {"output": str(self.out_path), "messages": dict(self.messages), "losses": self.losses}

    def lines(self) -> list[str]:
        """For people; losses stand on the screen of the recording already, but for what only a copy leaves out."""
        whole = "" if self.losses else "; every message that is stored was copied"
        total = f"salvaged {self.messages.total()} messages on {len(self.messages)} topics{whole}"
        left_out = [line for line in self.losses if NOT_COPIED in line]
        return [total, *left_out, f"recording  {self.out_path}"]


def write_salvaged(paths: Sequence[Path], out_path: Path, settings: IngestSettings) -> Salvaged:
    """Write all messages that are whole, of all types and byte for byte, as one MCAP file with an index.

    Parameters
    ----------
    paths : sequence of Path
        Bags and MCAP files.
    out_path : Path
    settings : IngestSettings

    Raises
    ------
    LogError
        If a recording is none.
    ArtifactError
        If nothing can be read, a recording is a text log, or the output cannot be written.
    """
    return copy_sources(paths, settings, lambda sources, refused: _write(sources, refused, out_path))


def _write(sources: Sequence[Source], refused: Mapping[Path, str], out_path: Path) -> Salvaged:
    """Write once; see `write_salvaged`."""
    text = next((source for source in sources if source.kind in _TEXT_KINDS), None)
    if text is not None:
        msg = (
            f"{text.name}: a text log has no messages to salvage; lines that are broken are left out wherever it is "
            "read. Leave out --salvage."
        )
        raise ArtifactError(msg)
    done = Salvaged(out_path)
    with ExitStack() as stack:
        containers = [one for source in sources for one in open_container(source, refused, stack)]
        with replacing(out_path) as part, part.open("wb") as stream:
            writer = McapCopy(stream, containers, "dynmap check")
            for stored in in_order(containers):
                writer.add(stored)
                done.messages[stored.channel.topic] += 1
            if not done.messages:
                msg = f"{', '.join(source.name for source in sources)}: no message can be read, so nothing is written"
                raise ArtifactError(msg)
            writer.finish()
    done.losses = [one.damage.line() for one in containers if one.damage]
    return done
