"""From a campaign file to its folder, with workers that only pretend to fly."""

import shlex
from threading import Event

import distributed
import pyarrow.parquet
import pytest
import tomli_w
from msgspec.structs import replace
from numba.core import config
from pretence import hold, never_warm, of_another_version, otherwise_with_log
from scipy.stats import beta

from testbed.campaign.compilation import compile_first
from testbed.campaign.engine import EngineError, workers
from testbed.campaign.flight import (
    UNLIKE,
    CampaignObserver,
    failure_folder,
    fly_campaign,
    replay_command,
)
from testbed.campaign.interval import success_rate
from testbed.campaign.journal import JournalError
from testbed.campaign.result import table_of, write_parquet
from testbed.campaign.summary import summarise, worst_runs
from testbed.campaign.sweep import load_campaign
from testbed.config import dump, find, load
from testbed.run.code_digest import code_digest

MASS = {"key": "vehicles.*.model.mass", "low": 11.0, "high": 14.0}
GRID = {"key": "controller.bandwidth", "values": [0.1, 0.2]}


class StopAfter(CampaignObserver):
    """An operator who interrupts."""

    def __init__(self, count):
        self.left = count

    def flown(self, run):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt


def fly(campaign, folder, fliers, watch=None):
    return fly_campaign(campaign, b"text", folder, fliers, watch or CampaignObserver())


def test_every_run_once_on_any_worker_and_after_any_stops(write, fliers, tmp_path):
    campaign = load_campaign(write(grid=[GRID], draw=[MASS], samples=20, keep=3))
    straight = fly(campaign, tmp_path / "a", fliers(1))
    assert [run.k for run in straight.runs] == list(range(40))
    assert straight.unlike == []
    for count in (1, 7, 13):
        with pytest.raises(KeyboardInterrupt):
            fly(campaign, tmp_path / "b", fliers(2), StopAfter(count))
    resumed = fly(campaign, tmp_path / "b", fliers(2))
    assert resumed.resumed >= 21
    assert resumed.runs == straight.runs
    for name, ended in (("a", straight), ("b", resumed)):
        write_parquet(tmp_path / f"{name}.parquet", table_of(campaign, ended.runs), {})
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()

    kept = sorted(path.name for path in (tmp_path / "b" / "failures").iterdir())
    assert kept == ["run_000000", "run_000003", "run_000006"]
    folder = failure_folder(tmp_path / "b", 3)
    assert (folder / "log.mcap").read_bytes() == b"log"
    assert (folder / "replay.txt").read_text().strip() == replay_command(
        campaign, tmp_path / "b", 3
    )

    again = fly(campaign, tmp_path / "b", fliers(2))  # nothing is left to fly
    assert (again.resumed, again.runs) == (40, straight.runs)


def test_a_run_that_was_not_the_same_the_second_time_stays_one(write, fliers, tmp_path):
    campaign = load_campaign(write(samples=9, keep=3))
    for _ in range(2):  # also when nothing is left to fly
        ended = fly(campaign, tmp_path / "a", replace(fliers(), fly_with_log=otherwise_with_log))
        assert ended.unlike == [0, 3]
    notes = [failure_folder(tmp_path / "a", k) / UNLIKE for k in (0, 3)]
    assert [note.read_text() for note in notes] == ["gas_g\n", "how it ended\n"]


def test_results_are_written_under_a_lock(write, fliers, tmp_path):
    campaign = load_campaign(write(samples=2))
    ends = []

    def finish(ended):
        with pytest.raises(JournalError, match="another process"):
            fly(campaign, tmp_path / "a", fliers())
        ends.append(ended)

    ended = fly_campaign(campaign, b"text", tmp_path / "a", fliers(), CampaignObserver(), finish)
    assert ends == [ended]


@pytest.mark.parametrize("draw", [[], [MASS]])
def test_a_campaign_is_extended_to_what_the_larger_one_gives(write, fliers, tmp_path, draw):
    keys = {"grid": [GRID], "draw": draw}
    few = load_campaign(write(samples=2, keep=1, **keys))
    more = {
        "samples": 5, "keep": 3, "success": 0.9, "confidence": 0.9, "description": "more",
        "limit_s": 7.0,
    }  # fmt: skip
    many = load_campaign(write(**more, **keys))
    fly(few, tmp_path / "a", fliers())
    extended, straight = (fly(many, tmp_path / name, fliers()) for name in "ab")
    assert (extended.resumed, straight.resumed) == (4, 0)
    for name, ended in (("a", extended), ("b", straight)):
        write_parquet(tmp_path / f"{name}.parquet", table_of(many, ended.runs), {})
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    folders = [sorted(p.name for p in (tmp_path / n / "failures").iterdir()) for n in "ab"]
    assert folders[0] == folders[1] == ["run_000000", "run_000003", "run_000006"]

    fewer = fly(
        few, tmp_path / "a", fliers()
    )  # and back: those behind the last sample do not count
    assert (fewer.resumed, fewer.runs) == (4, straight.runs[:4])
    assert fly(many, tmp_path / "a", fliers()).resumed == 10


def test_a_run_that_was_lost_is_flown_again_when_it_may_take_longer(write, fliers, tmp_path):
    keys = {"samples": 3, "keep": 0, "set": ["description='endless.1.'"]}
    short = load_campaign(write(limit_s=1.0, **keys))
    longer = load_campaign(write(limit_s=1.5, **keys))
    lost = fly(short, tmp_path / "a", fliers()).runs[1]
    assert (lost.outcome, "than 1 s" in lost.reason) == ("lost", True)
    again = fly(longer, tmp_path / "a", fliers())
    assert (again.resumed, "than 1.5 s" in again.runs[1].reason) == (2, True)
    assert fly(longer, tmp_path / "a", fliers()).resumed == 3


HYPERCUBE = {"design": "latin_hypercube", "draw": [MASS], "samples": 2}


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        ({"seed": 1}, {"seed": 2}, "`seed` was 1 and is 2"),
        (HYPERCUBE, {**HYPERCUBE, "samples": 3}, "`samples` was 2 and is 3"),
        ({}, {"most": {"gas_g": 1.0}}, "`most.gas_g` was nothing and is 1.0"),
        (
            {"grid": [GRID]}, {"grid": [{**GRID, "values": [0.1, 0.2, 0.3]}]},
            r"`grid.1.values.3` was nothing and is 0.3",
        ),
        ({"set": ["duration_s=9"]}, {}, r'`set.1` was "duration_s=9" and is nothing'),
    ],
)  # fmt: skip
def test_what_would_be_another_run_is_refused_by_its_key(
    write, fliers, tmp_path, before, now, words
):
    path = write(**before)
    fly_campaign(
        load_campaign(path), path.read_bytes(), tmp_path / "a", fliers(), CampaignObserver()
    )
    for _ in range(2):  # what is refused changes nothing
        with pytest.raises(
            JournalError, match=f"campaign or experiment has changed.*\n.*\n.*{words}"
        ):
            fly(load_campaign(write(**now)), tmp_path / "a", fliers())


def test_an_experiment_that_was_edited_is_refused_by_its_key(write, fliers, tmp_path):
    def campaign(duration):
        text = tomli_w.dumps(dump(load(find("hold"), [f"duration_s={duration}"])))
        (tmp_path / "mine.toml").write_text(text)
        return load_campaign(path)

    path = write(experiment="mine.toml")
    fly_campaign(campaign(8), path.read_bytes(), tmp_path / "a", fliers(), CampaignObserver())
    with pytest.raises(JournalError, match=r"`duration_s` of the experiment was 8\.0 and is 9\.0"):
        fly(campaign(9), tmp_path / "a", fliers())


def test_a_run_that_kills_its_workers_is_found_and_the_others_fly(write, fliers, tmp_path):
    campaign = load_campaign(write(samples=9, keep=0, set=["description='deadly.4.'"]))
    ended = fly(campaign, tmp_path / "a", fliers(1))
    assert [run.k for run in ended.runs] == list(range(9))
    assert [run.k for run in ended.runs if run.outcome == "lost"] == [4]


def test_a_run_that_never_ends_is_given_up_and_the_others_fly(write, fliers, tmp_path):
    keys = {"set": ["description='endless.4.'"], "limit_s": 1.0}
    campaign = load_campaign(write(samples=9, keep=0, **keys))
    ended = fly(campaign, tmp_path / "a", fliers(1))
    assert [run.k for run in ended.runs] == list(range(9))
    assert [run.k for run in ended.runs if run.outcome == "lost"] == [4]


def test_what_never_gets_warm_is_left_to_the_workers(monkeypatch, tmp_path):
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    compile_first("", [(0, ())], hold, never_warm, 1.0)
    assert not list(tmp_path.rglob("*"))  # and it is not noted as compiled


def test_a_cluster_flies_the_same_and_stays(write, fliers, tmp_path):
    campaign = load_campaign(write(grid=[GRID], samples=10, keep=2))
    straight = fly(campaign, tmp_path / "a", fliers(1))
    with workers(2, None) as lab:
        there = replace(fliers(1), scheduler=lab.scheduler.address)
        ended = fly(campaign, tmp_path / "b", there)
        assert len(lab.nthreads()) == 2
    assert ended.runs == straight.runs


def test_who_watches_can_ask_for_workers_while_there_are_none(write, fliers, tmp_path):
    class Counts(CampaignObserver):
        def flying(self, count_workers):
            counts.append(count_workers())
            lab.retire_workers(list(lab.nthreads()), close_workers=False)
            counts.append(count_workers())
            raise KeyboardInterrupt

    counts = []
    campaign = load_campaign(write(samples=1))
    with workers(1, None) as lab, pytest.raises(KeyboardInterrupt):
        fly(campaign, tmp_path / "a", replace(fliers(1), client=lab), Counts())
    assert counts == [1, 0]


def test_a_cluster_with_other_code_is_refused(monkeypatch):
    from testbed.campaign import engine

    with workers(1, None) as lab:
        digest = lab.run(engine.code_digest)
        monkeypatch.setattr(lab, "run", lambda *_, **__: dict.fromkeys(digest, "other"))
        with pytest.raises(EngineError, match="workers with the code of this machine"):
            engine._same_code(lab, "tcp://lab:8786")
        monkeypatch.setattr(lab, "run", lambda *_, **__: {})
        with pytest.raises(EngineError, match="without workers"):
            engine._same_code(lab, "tcp://lab:8786")


def test_a_worker_with_other_code_that_joins_late_is_refused(write, fliers, tmp_path):
    campaign = load_campaign(write(samples=9, keep=0))
    with pytest.raises(EngineError, match=f"code of this machine, {code_digest()}\n.*other on"):
        fly(campaign, tmp_path / "a", replace(fliers(1), fly=of_another_version))
    resumed = fly(campaign, tmp_path / "a", fliers(1))
    assert [run.k for run in resumed.runs] == list(range(9))


def test_what_an_interrupt_breaks_in_dask_is_not_said(capfd):
    with workers(1, None) as lab:
        over = Event()
        lab.loop.add_callback(lambda: 1 / 0)  # as its own do when their caller is gone
        lab.loop.add_callback(over.set)
        over.wait()
    assert capfd.readouterr().err == ""


def test_a_cluster_that_is_not_there_is_said():
    with pytest.raises(EngineError, match="a Dask scheduler"), workers(1, "tcp://127.0.0.1:9"):
        pass


def test_an_address_that_dask_cannot_use_is_said(monkeypatch):
    def no_tls(*_, **__):
        raise TypeError("TLS expects a `ssl_context`")

    monkeypatch.setattr(distributed, "Client", no_tls)
    with pytest.raises(EngineError, match="found     TLS"), workers(1, "tls://127.0.0.1:9"):
        pass


def test_workers_that_cannot_start_are_said(monkeypatch):
    def no_more_files(*_, **__):
        raise RuntimeError("Cluster failed to start: Too many open files")

    monkeypatch.setattr(distributed, "LocalCluster", no_more_files)
    with pytest.raises(EngineError, match="found     Cluster failed"), workers(1, None):
        pass


def test_the_table_has_a_row_per_run_and_types_a_reader_expects(write, fliers, tmp_path):
    campaign = load_campaign(write(grid=[GRID], draw=[MASS], samples=3))
    ended = fly(campaign, tmp_path / "a", fliers())
    write_parquet(tmp_path / "r.parquet", table_of(campaign, ended.runs), {"campaign": "try"})
    table = pyarrow.parquet.read_table(tmp_path / "r.parquet")
    assert table.column_names[:6] == [
        "run", "controller.bandwidth", "vehicles.*.model.mass", "seed", "outcome", "reason",
    ]  # fmt: skip
    assert table["run"].to_pylist() == list(range(6))
    assert str(table.schema.field("goal_rms_m").type) == "double"
    assert str(table.schema.field("contacts").type) == "int64"
    assert table.schema.metadata[b"campaign"] == b"try"


def test_a_number_that_no_run_has_is_a_column_of_numbers(tmp_path):
    write_parquet(tmp_path / "r.parquet", {"run": [0, 1], "settle_s": [None, None]}, {})
    table = pyarrow.parquet.read_table(tmp_path / "r.parquet")
    assert str(table.schema.field("settle_s").type) == "double"
    assert table["settle_s"].to_pylist() == [None, None]


def test_the_summary_counts(write, fliers, tmp_path):
    campaign = load_campaign(write(grid=[GRID], samples=15, keep=0))
    ended = fly(campaign, tmp_path / "a", fliers())
    summary = summarise(campaign, "hold", ended)
    assert (summary.runs, summary.succeeded) == (30, 20)
    assert summary.outcomes == {"failed": 10, "passed": 20}
    assert summary.reasons == {"failed: settle_s": 10}
    assert [(case.rate.runs, case.rate.succeeded) for case in summary.cases] == [(15, 10)] * 2
    error = summary.spreads[0]
    values = sorted(1e3 * run.columns["goal_rms_m"] for run in ended.runs)
    assert (error.best, error.worst) == (values[0], values[-1])
    assert error.p95 == values[28]  # 29 of 30 are at least as good
    assert [run.outcome for run in worst_runs(ended.runs, error.quantity, 11)] == [
        *["failed"] * 10, "passed",
    ]  # fmt: skip


@pytest.mark.parametrize(("succeeded", "runs"), [(0, 10), (10, 10), (7, 10), (993, 1000)])
def test_the_interval_is_near_the_exact_one_and_holds_the_rate(succeeded, runs):
    rate = success_rate(succeeded, runs, 0.95)
    assert rate.low - 1e-12 <= succeeded / runs <= rate.high + 1e-12
    low = beta.ppf(0.025, succeeded, runs - succeeded + 1) if succeeded else 0.0
    high = beta.ppf(0.975, succeeded + 1, runs - succeeded) if succeeded < runs else 1.0
    assert (rate.low, rate.high) == (pytest.approx(low, abs=0.05), pytest.approx(high, abs=0.05))


def test_a_replay_command_survives_the_shell(write, tmp_path):
    campaign = load_campaign(write(draw=[MASS]))
    words = shlex.split(replay_command(campaign, tmp_path / "a b", 0))
    assert words == [
        "testbed", "run", str(tmp_path / "a b" / "base.toml"), *campaign.overrides(0)
    ]  # fmt: skip
