"""Key files: private, complete, and with a timestamp that never decreases."""

import os
import time

import pytest

from swarm.errors import InputError
from swarm.ground.signing_key import read_key, signing_with
from swarm.mavlink.signing import timestamp_at

KEY = bytes(range(32))


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "team.key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    return path


def test_hexadecimal_digits_and_bytes_are_keys(key_file):
    assert read_key(key_file) == KEY
    key_file.write_bytes(KEY)
    assert read_key(key_file) == KEY


def test_a_key_that_others_may_read_is_refused(key_file):
    key_file.chmod(0o640)
    with pytest.raises(InputError, match=r"other users may read this key \(mode 640\).*chmod 600"):
        read_key(key_file)


@pytest.mark.parametrize("content", ["", "abc", "zz" * 32, "ab" * 31, "ab" * 33])
def test_other_content_is_refused(key_file, content):
    key_file.write_text(content)
    with pytest.raises(InputError, match="expected 64 hexadecimal digits or 32 bytes"):
        read_key(key_file)


def test_a_missing_key_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.key: no such file or directory"):
        read_key(tmp_path / "none.key")


def test_the_timestamp_is_saved_and_never_decreases(key_file):
    saved = key_file.with_name("team.key.timestamp")
    with signing_with(str(key_file)) as signing:
        assert signing.timestamp >= timestamp_at(time.time() - 60.0)
        signing.timestamp += 10**12  # a vehicle whose clock is months ahead
        last = signing.timestamp
    assert int(saved.read_text()) == last
    assert saved.stat().st_mode & 0o077 == 0
    with signing_with(str(key_file)) as signing:
        assert signing.timestamp > last


def test_a_damaged_timestamp_is_replaced_by_the_clock(key_file):
    key_file.with_name("team.key.timestamp").write_text("nonsense")
    with signing_with(str(key_file)) as signing:
        assert abs(signing.timestamp - timestamp_at(time.time())) < 10**7


@pytest.mark.skipif(os.getuid() == 0, reason="root can write everywhere")
def test_a_timestamp_that_cannot_be_saved_is_refused_before_the_flight(key_file):
    key_file.parent.chmod(0o500)
    try:
        with (
            pytest.raises(InputError, match="the timestamp cannot be saved"),
            signing_with(str(key_file)),
        ):
            pass
    finally:
        key_file.parent.chmod(0o700)


def test_without_a_key_there_is_no_signing():
    with signing_with(None) as signing:
        assert signing is None
