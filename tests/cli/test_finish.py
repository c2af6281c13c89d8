"""A run that was stopped before its log began is finished without one."""

import json

import tomli_w

from testbed.cli.finish import finish_run
from testbed.config import dump, find, load


def test_a_run_without_a_log_has_a_result_and_no_traceback(tmp_path, capsys):
    (tmp_path / "config.toml").write_text(tomli_w.dumps(dump(load(find("hold")))))
    finish_run(tmp_path, "twin", None, as_json=True)
    said = capsys.readouterr()
    assert json.loads(said.out)["fault"] is None
    assert "log.mcap: No such file" in said.err
    assert not (tmp_path / "report.html").exists()
