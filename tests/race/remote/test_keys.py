"""Keys of networked races: which clients a server accepts."""

import os
import stat
import time

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError, RemoteError
from stkzoo.race import find_driver
from stkzoo.race.remote import (
    RaceServer,
    RemoteDriverGroup,
    ServerKeys,
    connection,
    new_key_files,
    new_keys,
    read_public,
    read_publics,
    read_secret,
)
from tests.support.remote_race import raw_client, server_thread


@pytest.fixture
def closed_server():
    """Runs a server that accepts one client; yields its address, its public key and the client."""
    own, client = new_keys(), new_keys()
    keys = ServerKeys(own, {client.public})
    with server_thread([find_driver("heuristic")], keys=keys) as server:
        yield server.address, own.public, client


@pytest.mark.parametrize("stranger", ["another key", "no key", "no encryption", "wrong server"])
def test_peers_without_the_right_keys_cannot_connect(closed_server, stranger):
    address, server_key, client = closed_server
    keys = {"another key": new_keys(), "wrong server": client}.get(stranger)
    server_keys = {"no encryption": [], "wrong server": [new_keys().public]}
    with pytest.raises(RemoteError, match=r"refuses the connection|in time"):
        RemoteDriverGroup(
            [address],
            keys=keys,
            server_keys=server_keys.get(stranger, [server_key]),
            connect_timeout=3.0,
        )
    with RemoteDriverGroup([address], keys=client, server_keys=[server_key]) as group:
        assert len(group.drivers) == 1


def test_a_connection_refused_before_its_first_message_names_the_keys(closed_server, monkeypatch):
    def wait_for_refusal(_):
        time.sleep(0.05)
        return "1"

    monkeypatch.setattr(connection, "version", wait_for_refusal)
    address, server_key, _ = closed_server
    with pytest.raises(RemoteError, match="refuses the connection"):
        RemoteDriverGroup([address], keys=new_keys(), server_keys=[server_key])


@pytest.mark.slow
def test_a_message_without_keys_gets_no_reply(closed_server):
    with raw_client(closed_server[0]) as socket:
        for _ in range(20):
            socket.send(b"\x80")
        assert not socket.poll(1000)


def test_a_server_with_a_key_and_no_list_accepts_all_who_know_it():
    own = new_keys()
    with (
        server_thread([find_driver("heuristic")], keys=ServerKeys(own)) as server,
        RemoteDriverGroup([server.address], server_keys=[own.public]) as group,
    ):
        assert len(group.drivers) == 1


@pytest.mark.parametrize("address", ["*:5599", "0.0.0.0:5599", "[::]:5599", "192.168.3.4:5599"])
@pytest.mark.parametrize("keys", [ServerKeys(), ServerKeys(new_keys())], ids=["none", "own"])
def test_listening_to_other_machines_requires_keys(address, keys):
    with pytest.raises(ConfigError, match="other machines can reach"):
        RaceServer([find_driver("heuristic")], address, keys=keys)


def test_with_keys_or_insecure_a_server_listens_to_other_machines():
    keys = ServerKeys(new_keys(), {new_keys().public})
    for options in ({"keys": keys}, {"insecure": True}):
        with RaceServer([find_driver("heuristic")], "*:*", **options) as server:
            assert server.address.startswith("tcp://0.0.0.0:")


def test_key_files_hold_a_pair_and_only_the_owner_can_read_the_secret(tmp_path):
    secret, public = new_key_files("ada", tmp_path)
    assert stat.S_IMODE(os.stat(secret).st_mode) == 0o600
    assert read_secret(secret).public == read_public(public) == read_public(read_public(public))
    assert read_secret(secret).secret not in public.read_text()
    assert sorted(os.listdir(tmp_path)) == ["ada.public", "ada.secret"]


def test_a_secret_that_others_can_read_is_refused(tmp_path):
    secret, _ = new_key_files("ada", tmp_path)
    secret.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_secret(secret)


def test_public_keys_can_be_read_from_a_folder_or_a_file(tmp_path):
    publics = [new_key_files(name, tmp_path)[1] for name in ("ada", "bob")]
    together = tmp_path / "all.txt"
    together.write_text("# my students\n\n" + "".join(file.read_text() for file in publics))
    assert read_publics([tmp_path]) == {read_public(file) for file in publics}
    assert read_publics([together]) == read_publics([tmp_path]) == read_publics(publics)


@pytest.mark.parametrize("text", ["", "hello\n", "public abc\n", "\x00\xff"])
def test_an_invalid_key_is_refused(tmp_path, text):
    file = tmp_path / "x.secret"
    file.write_bytes(text.encode("latin-1"))
    for read in (read_secret, read_public):
        with pytest.raises(ConfigError, match=r"key"):
            read(file)


@pytest.mark.parametrize("name", ["", "../a", "a/b", ".a", "a b"])
def test_invalid_key_names_are_refused(tmp_path, name):
    with pytest.raises(ConfigError, match="key name"):
        new_key_files(name, tmp_path)


def test_the_command_makes_keys_and_replaces_none(tmp_path, capsys):
    words = ["keys", "new", "ada", "--folder", str(tmp_path)]
    assert main(words) == 0
    assert read_public(tmp_path / "ada.public") in capsys.readouterr().out
    assert main(words) == 2
