"""Messages of recordings into an MCAP file, byte for byte."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO

from mcap.writer import CompressionType, Writer

from dynmap_cli.export.messages import Container
from dynmap_cli.ingest.messages.stored import Channel, StoredMessage


class McapCopy:
    """Writes messages with their channels; attachments and metadata of MCAP files come first."""

    def __init__(self, stream: IO[bytes], containers: Sequence[Container], library: str) -> None:
        self._writer = writer = Writer(stream, compression=CompressionType.ZSTD, enable_crcs=True)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[Channel, int] = {}
        profiles = {container.profile for container in containers}
        writer.start(profile=profiles.pop() if len(profiles) == 1 else "", library=library)
        for container in containers:
            for one in container.attachments:
                writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
            for note in container.metadata:
                writer.add_metadata(note.name, note.metadata)

    def add(self, stored: StoredMessage) -> None:
        """Write a message as it is."""
        number = self._channels.get(stored.channel)
        if number is None:
            number = self._channels[stored.channel] = self._register(stored.channel)
        self._writer.add_message(
            number, stored.logged_ns, stored.data, stored.published_ns, sequence=stored.sequence
        )

    def finish(self) -> None:
        """Write index and summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _register(self, channel: Channel) -> int:
        """Announce a channel, and its schema where it is new."""
        schema = channel.schema_name, channel.schema_encoding, channel.schema_data
        if channel.schema_name and schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(*schema)
        return self._writer.register_channel(
            channel.topic, channel.message_encoding, self._schemas.get(schema, 0), dict(channel.metadata)
        )
