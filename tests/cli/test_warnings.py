"""Warnings of stages go to stderr, whatever stdout is for; programs read them in JSON as well."""

import json

import pytest

from dynmap_cli.commands.options import print_summary


@pytest.mark.parametrize("as_json", [True, False])
def test_warnings_go_to_stderr(capsys, as_json):
    print_summary(
        {"n": 1}, ["map: all well", "map: warning: look here", "warning: and here"], as_json=as_json
    )
    out, err = capsys.readouterr()
    assert err.splitlines() == ["map: warning: look here", "warning: and here"]
    if as_json:
        assert json.loads(out) == {"n": 1, "warnings": ["map: look here", "and here"]}
    else:
        assert out.splitlines() == ["map: all well"]
