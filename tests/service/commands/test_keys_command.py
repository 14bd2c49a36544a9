"""The keys of a first start: made once, whole, and never over keys that are there."""

import json
import stat

import pytest

from residuum.service.cli import BAD_INPUT, run
from residuum.service.security.access import ApiKeys, Role


@pytest.fixture
def keys(tmp_path, capsys):
    def keys():
        assert run(["keys", str(tmp_path), "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    return keys


def test_a_key_is_made_once(keys, tmp_path):
    made = keys()
    assert made["made"] and ApiKeys(tmp_path / "api_keys").caller(made["key"]).role is Role.ENGINEER
    assert {
        stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("api_keys", "metrics_key")
    } == {0o640}
    users = (tmp_path / "broker_users").read_text()
    again = keys()
    assert (
        users == (tmp_path / "broker_users").read_text()
        and (tmp_path / "broker_password").read_text() not in users
    )
    assert (again["made"], again["key"]) == (False, None)


def test_a_lost_metrics_key_is_made_anew_and_the_others_stay(keys, tmp_path):
    key = keys()["key"]
    lost = (tmp_path / "metrics_key").read_text()
    (tmp_path / "metrics_key").unlink()
    assert not keys()["made"]
    known = ApiKeys(tmp_path / "api_keys")
    assert known.caller(lost) is None and known.caller(key).role is Role.ENGINEER
    assert known.caller((tmp_path / "metrics_key").read_text()).role is Role.MONITOR


def test_a_broken_file_of_keys_is_named_and_left_alone(tmp_path, capsys):
    (tmp_path / "api_keys").write_text("me wizard 00\n")
    assert run(["keys", str(tmp_path)]) == BAD_INPUT
    assert "api_keys, line 1: must be" in capsys.readouterr().err
    assert (tmp_path / "api_keys").read_text() == "me wizard 00\n" and not (
        tmp_path / "metrics_key"
    ).exists()


def test_a_place_that_cannot_be_written_is_named(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert run(["keys", str(tmp_path / "file" / "keys")]) == BAD_INPUT
    said = capsys.readouterr()
    assert "cannot be written" in said.err and said.err.count("\n") == 1 and said.out == ""
