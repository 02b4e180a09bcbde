"""Databases of a recorder that was killed: what its journals hold is played back into a copy, and that is said."""

import os
import re
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.files.manifest import sha256_of
from dynmap_cli.ingest.containers.opening import check_path
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.corpus import FILES, FOLDERS, WORLD, _packed

SETTINGS = IngestSettings()
KEPT = 60


def killed_with_log(source, target):
    """Copy a database as it is when most of its messages lie in the write-ahead log yet."""
    with closing(sqlite3.connect(source, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA wal_autocheckpoint=0")
        rows = connection.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
        connection.execute("DELETE FROM messages WHERE id > ?", (KEPT,))
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        for start in range(KEPT, len(rows), 20):
            connection.execute("BEGIN")
            connection.executemany(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows[start : start + 20]
            )
            connection.execute("COMMIT")
        shutil.copy(source, target)
        shutil.copy(f"{source}-wal", f"{target}-wal")
    source.unlink()
    return target


@pytest.fixture
def killed(tmp_path):
    return killed_with_log(FILES["db3"](tmp_path), tmp_path / "killed.db3")


def read(path):
    return read_recordings([path], SETTINGS)


def log_of(path):
    return path.with_name(f"{path.name}-wal")


def test_what_lies_in_the_log_is_read_and_nothing_is_written_beside_it(killed):
    before = {path: path.read_bytes() for path in killed.parent.rglob("*") if path.is_file()}
    log, report = read(killed)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    size = log_of(killed).stat().st_size
    assert report.warnings == (
        f"killed.db3: killed.db3-wal beside it, of a recorder that was not closed: {size} of its {size} bytes are "
        "read into a copy",
    )
    assert {path: path.read_bytes() for path in killed.parent.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_a_log_that_is_cut_off_is_read_up_to_there(killed, share):
    log = log_of(killed)
    log.write_bytes(log.read_bytes()[: int(share * log.stat().st_size)])
    found, report = read(killed)
    assert found.n_scans >= 60 * share * 0.7
    np.testing.assert_array_equal(found.ranges_m, WORLD.ranges_m[: found.n_scans])
    assert "killed.db3-wal beside it" in report.warnings[0]


def test_a_log_of_other_bytes_costs_nothing(killed):
    log_of(killed).write_bytes(b"no log at all" * 999)
    found, report = read(killed)
    assert found.n_scans == 19
    assert "0 of its 12987 bytes are read into a copy" in report.warnings[0]


def test_a_log_for_which_there_is_no_room_is_said(killed):
    found, report = read_recordings([killed], IngestSettings(max_unpacked_gib=1 / (1 << 14)))
    assert found.n_scans == 19
    assert (
        "killed.db3-wal beside it, of a recorder that was killed, is not read: a copy" in report.warnings[0]
    )


@pytest.mark.parametrize("has_metadata", [True, False])
def test_logs_beside_the_files_of_a_folder_are_read(has_metadata, tmp_path):
    folder = FOLDERS["folder db3"](tmp_path)
    file = folder / "a.db3"
    killed_with_log(file.rename(tmp_path / "b.db3"), file)
    if not has_metadata:
        (folder / "metadata.yaml").unlink()
    log, report = read(folder)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "a.db3-wal beside it" in report.warnings[0]
    assert not report.damage


def test_a_log_in_an_archive_is_read(tmp_path):
    folder = FOLDERS["folder db3"](tmp_path)
    file = folder / "a.db3"
    killed_with_log(file.rename(tmp_path / "b.db3"), file)
    log, _ = read(_packed(lambda _: folder, "zip")(tmp_path))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)


def with_journal(tmp_path):
    """A database in the middle of a transaction that took half of it away."""
    source, target = FILES["db3"](tmp_path), tmp_path / "killed.db3"
    with closing(sqlite3.connect(source, isolation_level=None)) as connection:
        connection.execute("PRAGMA cache_size=2")
        connection.execute("BEGIN")
        connection.execute("DELETE FROM messages WHERE id % 2")
        shutil.copy(source, target)
        shutil.copy(f"{source}-journal", f"{target}-journal")
    return target


def test_a_transaction_that_was_broken_off_is_taken_back(tmp_path):
    log, report = read(with_journal(tmp_path))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "of a transaction that was broken off, was played back into a copy" in report.warnings[0]


def test_a_journal_that_names_another_file_is_not_played_back(tmp_path):
    """SQLite deletes that file, whatever it is."""
    path, other = with_journal(tmp_path), tmp_path / "precious"
    other.write_bytes(b"")
    name = str(other).encode()
    tail = (1 << 30).to_bytes(4, "big") + name + len(name).to_bytes(4, "big") + sum(name).to_bytes(4, "big")
    journal = path.with_name(f"{path.name}-journal")
    journal.write_bytes(journal.read_bytes() + tail + b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7")
    _, report = read(path)
    assert other.exists()
    assert any(
        "is not read: it belongs to a transaction over several files" in line for line in report.warnings
    )


def test_bytes_behind_the_end_of_a_database_are_said(tmp_path):
    path = FILES["db3"](tmp_path)
    data = path.read_bytes()
    path.write_bytes(data + data)
    log, report = read(path)
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert f"{len(data)} bytes behind its end are not read" in report.warnings[0]


def flipped(path, place):
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)


def damages_of_a_log():
    """Changes of a log that lose some of it; a part of it, its head, salts and pages."""
    for share in (0.1, 0.3, 0.7, 0.95):
        yield (
            f"cut at {share}",
            lambda log, share=share: log.write_bytes(log.read_bytes()[: int(share * log.stat().st_size)]),
        )
    for place in (*range(32), 32 + 8, 32 + 12, 32 + 100):
        yield f"flipped at {place}", lambda log, place=place: flipped(log, place)
    for share in (0.5, 0.8):
        yield f"flipped at {share}", lambda log, share=share: flipped(log, int(share * log.stat().st_size))
    yield "other bytes", lambda log: log.write_bytes(b"no log at all" * 999)
    yield "a few bytes", lambda log: log.write_bytes(b"\x37\x7f\x06\x82")
    yield "zeros", lambda log: log.write_bytes(bytes(log.stat().st_size))


@pytest.mark.parametrize("change", [pytest.param(change, id=name) for name, change in damages_of_a_log()])
def test_a_damaged_log_is_damage_that_strict_refuses(killed, change):
    change(log_of(killed))
    _, report = read(killed)
    assert any("killed.db3-wal beside it" in line and "damaged or cut off" in line for line in report.damage)
    with pytest.raises(LogError, match=r"is damaged; .*killed\.db3-wal.* damaged or cut off"):
        read_recordings([killed], IngestSettings(strict=True))


def test_a_damaged_log_in_a_folder_is_damage(tmp_path):
    folder = FOLDERS["folder db3"](tmp_path)
    file = folder / "a.db3"
    killed_with_log(file.rename(tmp_path / "b.db3"), file)
    flipped(log_of(file), log_of(file).stat().st_size // 2)
    with pytest.raises(LogError, match=r"a\.db3-wal.* damaged or cut off"):
        read_recordings([folder], IngestSettings(strict=True))


def test_a_log_with_pages_of_before_is_whole(tmp_path):
    """What lies behind the new pages was written back before the log was begun again."""
    source, target = FILES["db3"](tmp_path), tmp_path / "killed.db3"
    with closing(sqlite3.connect(source, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("UPDATE messages SET timestamp = timestamp + 1")
        connection.execute("UPDATE messages SET timestamp = timestamp - 1")
        connection.execute("PRAGMA wal_checkpoint(RESTART)").fetchall()
        connection.execute("CREATE TABLE small (number)")
        shutil.copy(source, target)
        shutil.copy(f"{source}-wal", f"{target}-wal")
    log, report = read_recordings([target], IngestSettings(strict=True))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "the others were written back before" in report.warnings[0]
    # Where the log was cut among them, nothing is lost either.
    log_of(target).write_bytes(log_of(target).read_bytes()[:-5000])
    read_recordings([target], IngestSettings(strict=True))


def test_a_transaction_that_was_not_ended_in_a_log_is_no_damage(tmp_path):
    source, target = FILES["db3"](tmp_path), tmp_path / "killed.db3"
    with closing(sqlite3.connect(source, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA cache_size=2")
        connection.execute("BEGIN")
        connection.execute("DELETE FROM messages WHERE id % 2")
        shutil.copy(source, target)
        shutil.copy(f"{source}-wal", f"{target}-wal")
    assert log_of(target).stat().st_size > 9999
    log, report = read_recordings([target], IngestSettings(strict=True))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert "are of no whole transaction" in report.warnings[0]


def journal_of(path):
    return path.with_name(f"{path.name}-journal")


def put(path, place, number):
    data = bytearray(path.read_bytes())
    data[place : place + 4] = number.to_bytes(4, "big")
    path.write_bytes(data)


def test_a_journal_of_which_no_page_is_whole_is_not_played_back(tmp_path):
    path = with_journal(tmp_path)
    put(journal_of(path), 12, 12345)
    _, report = read(path)
    lines = [line for line in report.damage if "killed.db3-journal" in line]
    assert len(lines) == 1
    assert re.search(r"is not read: none of its \d+ pages is whole", lines[0])


def test_a_journal_that_is_cut_off_says_how_many_pages_were_played_back(tmp_path):
    path = with_journal(tmp_path)
    journal = journal_of(path)
    journal.write_bytes(journal.read_bytes()[: 512 + 4104 + 99])
    _, report = read(path)
    assert any(
        "1 of its 2 pages" in line and "were played back into a copy" in line for line in report.damage
    )
    with pytest.raises(LogError, match="1 of its 2 pages"):
        read_recordings([path], IngestSettings(strict=True))


@pytest.mark.parametrize("n_pages", [1 << 31, 4000])
def test_a_journal_that_states_more_pages_than_there_is_room_for_is_not_played_back(tmp_path, n_pages):
    path = with_journal(tmp_path)
    put(journal_of(path), 16, n_pages)
    log, report = read(path)
    assert log.n_scans > 0
    assert any("it states more pages than it and the file have room for" in line for line in report.damage)
    assert not any("879" in line for line in report.warnings)


def odd_file(path, kind):
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")


@pytest.mark.parametrize("kind", ["pipe", "link"])
@pytest.mark.parametrize("suffix", ["-wal", "-journal"])
@pytest.mark.parametrize("is_folder", [True, False])
def test_what_is_named_like_a_journal_and_is_no_file_is_not_read(tmp_path, kind, suffix, is_folder):
    path = FOLDERS["folder db3"](tmp_path) if is_folder else FILES["db3"](tmp_path)
    file = path / "a.db3" if is_folder else path
    odd_file(file.with_name(file.name + suffix), kind)
    sha256_of(path)
    check_path(path)
    log, report = read_recordings([path], IngestSettings(strict=True))
    np.testing.assert_array_equal(log.ranges_m, WORLD.ranges_m)
    assert f"a.db3{suffix} beside it is no regular file and is not read" in report.warnings[0]
