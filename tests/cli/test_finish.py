"""A run that was stopped before its log began is finished without one."""

import json

import msgspec
import tomli_w
from msgspec.structs import replace

from testbed.cli.exit_code import FAULT, INTERRUPTED
from testbed.cli.finish import finish_run
from testbed.cli.result import code_of, print_result
from testbed.config import dump, find, load
from testbed.core.codes import FaultId, FaultReport
from testbed.metrics.run_metrics import Metrics


def test_a_run_without_a_log_has_a_result_and_no_traceback(tmp_path, capsys):
    (tmp_path / "config.toml").write_text(tomli_w.dumps(dump(load(find("hold")))))
    finish_run(tmp_path, "twin", None, as_json=True)
    said = capsys.readouterr()
    assert json.loads(said.out)["fault"] is None
    assert "log.mcap: No such file" in said.err
    assert not (tmp_path / "report.html").exists()


def test_an_operators_stop_on_wires_is_not_called_a_fault(tmp_path, capsys):
    (tmp_path / "config.toml").write_text(tomli_w.dumps(dump(load(find("hold")))))
    finish_run(tmp_path, "bench", None, as_json=True)
    metrics = msgspec.json.decode(capsys.readouterr().out, type=Metrics)
    stop = FaultReport(FaultId.STOPPED, "stopped by the operator")
    metrics = replace(metrics, duration_s=8.24, fault=stop.words, fault_report=stop)
    print_result(metrics, load(find("hold")), tmp_path)
    said = capsys.readouterr().out
    assert "\nstopped by the operator after 8.2 s: not judged\n" in said
    assert "fault" not in said
    assert code_of(metrics) == INTERRUPTED  # as on the twin
    silent = FaultReport(FaultId.VEHICLE_SILENT, "vehicle silent", vehicle="sat1")
    assert code_of(replace(metrics, fault=silent.words, fault_report=silent)) == FAULT
